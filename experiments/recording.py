"""One episode, kept frame by frame: what the figures and the viewer draw."""

from dataclasses import dataclass, fields
from os import PathLike
from pathlib import Path

import torch
from torch import Tensor


@dataclass(frozen=True, kw_only=True)
class Recording:
    """One episode of F frames, in lattice units unless said otherwise; N markers, grid [Y, X].

    Args:
        body_length: L, nodes.
        period: T, steps per tail beat.
        domain: (X, Y) nodes.
        frames_per_T: frames per period, as asked for; ``time`` is exact.
        time: ``[F]`` in T, increasing.
        outline: ``[F, N, 2]`` closed outline (x, y), nose first.
        vorticity: ``[F, Y, X]`` in 1/T, float16.
        food: ``[F, 2]`` (x, y).
        head: ``[F, 2]`` (x, y).
        heading: ``[F]`` direction the fish faces, radians.
        action: ``[F]`` the action in force, integer.
        reward: ``[F]`` the reward of the action in force.
        capture_radius: distance from head to food that counts as a capture, nodes.
        captured: whether the episode ended with a capture.
    """

    body_length: float
    period: int
    domain: tuple[int, int]
    frames_per_T: int
    time: Tensor
    outline: Tensor
    vorticity: Tensor
    food: Tensor
    head: Tensor
    heading: Tensor
    action: Tensor
    reward: Tensor
    capture_radius: float
    captured: bool

    def __post_init__(self) -> None:
        """Refuse shapes that do not belong together, and numbers that cannot be drawn."""
        if self.body_length <= 0 or self.period <= 0:
            raise ValueError(
                f"body_length = {self.body_length}, period = {self.period}: both must be positive"
            )
        num_frames = self.time.numel()
        if num_frames == 0:
            raise ValueError("the recording has no frame: record at least one")
        x, y = self.domain
        num_markers = self.outline.shape[1] if self.outline.dim() == 3 else 3
        expected: dict[str, tuple[int, ...]] = {
            "time": (num_frames,),
            "outline": (num_frames, num_markers, 2),
            "vorticity": (num_frames, y, x),
            "food": (num_frames, 2),
            "head": (num_frames, 2),
            "heading": (num_frames,),
            "action": (num_frames,),
            "reward": (num_frames,),
        }
        for name, shape in expected.items():
            values: Tensor = getattr(self, name)
            if tuple(values.shape) != shape:
                raise ValueError(f"{name} has shape {tuple(values.shape)}, expected {shape}")
            if not values.isfinite().all():
                raise ValueError(f"{name} is not finite everywhere: drop the frames that diverged")
        if (self.time.diff() <= 0).any():
            raise ValueError("time does not increase from frame to frame: sort or drop frames")

    @property
    def num_frames(self) -> int:
        """Number of frames F."""
        return self.time.numel()

    def save(self, path: str | PathLike[str]) -> None:
        """Write everything to one file."""
        torch.save({field.name: getattr(self, field.name) for field in fields(self)}, path)

    @classmethod
    def load(cls, path: str | PathLike[str]) -> "Recording":
        """Read what ``save`` wrote; a file of anything else raises ``ValueError``."""
        if not Path(path).is_file():
            raise FileNotFoundError(f"no recording at {path}: give the file that save() wrote")
        saved = torch.load(path, weights_only=True)
        known = {field.name for field in fields(cls)}
        if not isinstance(saved, dict) or set(saved) != known:
            got = sorted(saved) if isinstance(saved, dict) else type(saved).__name__
            raise ValueError(f"{path} is no recording: it holds {got}, expected {sorted(known)}")
        return cls(**saved)
