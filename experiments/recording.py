"""One episode, kept frame by frame: what the figures and the viewer draw."""

from collections.abc import Callable
from dataclasses import dataclass, fields
from os import PathLike
from pathlib import Path

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase

from experiments.scenes import TaskView
from experiments.watching import Watch, run_episodes
from fishrl.viewer import Frame


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


def record_episodes(
    *,
    env: EnvBase,
    policy: Callable[[TensorDictBase], TensorDictBase],
    starts: TensorDictBase,
    frames_per_T: int = 10,
    on_episodes: Callable[[int], None] | None = None,
    give: Callable[[int, Frame], None] | None = None,
) -> list[Recording]:
    """Run one episode from each start, all side by side, and keep what there is to see.

    The last frame of an episode is the very look at which it ended. A flow that diverges is kept up
    to the decision before.

    Args:
        env: of a task with food; see ``watching.run_episodes``.
        policy: writes ``action``; a learned one acts greedily.
        starts: ``[E]``, no more than the env has flows.
        frames_per_T: frames per period, about: one of every so many looks that the task takes.
        on_episodes: called with the number of episodes that have just ended.
        give: called with every frame, too, and the number of the start that it belongs to.

    Returns:
        E recordings, in the order of their starts.
    """
    task = env.base_env.task
    view, config = TaskView(task), task.flow_config()
    frames: dict[int, list[Frame]] = {}
    captured: dict[int, bool] = {}
    watches: list[Watch] = []
    row_of: dict[int, int] = {}

    def make_watch(start_of: dict[int, int]) -> Watch:
        row_of.update({start: row for row, start in start_of.items()})
        frames.update({row: [] for row in start_of})

        def take(row: int, frame: Frame) -> None:
            frames[row].append(frame)
            if give is not None:
                give(start_of[row], frame)

        watch = Watch(task, view.read, rows=start_of, frames_per_T=frames_per_T, give=take)
        watches.append(watch)
        return watch

    def note(step: TensorDictBase, ended: set[int]) -> None:
        captured.update({row: bool(step["next", "captured"][row].any()) for row in ended})
        if on_episodes is not None and ended:
            on_episodes(len(ended))

    run_episodes(env, policy, starts, make_watch=make_watch, on_step=note)
    return [
        Recording(
            body_length=float(task.scales.body_length),
            period=task.scales.period,
            domain=(config.width, config.height),
            frames_per_T=watches[0].frames_per_T,
            capture_radius=float(task.capture_radius),
            captured=captured[row],
            **_stack(frames.pop(row)),
        )
        for row in (row_of[start] for start in range(starts.shape[0]))
    ]


def _stack(frames: list[Frame]) -> dict[str, Tensor]:
    """Return the tensors of a recording."""
    names = {"outline": "fish", **{name: name for name in ("food", "head", "heading", "reward")}}
    stacked = {
        name: torch.stack([frame.values[key] for frame in frames]).float()
        for name, key in names.items()
    }
    return {
        **stacked,
        "time": torch.tensor([frame.time for frame in frames], dtype=torch.float64),
        "vorticity": torch.stack([frame.values["vorticity"] for frame in frames]),
        "action": torch.stack([frame.values["action"] for frame in frames]),
    }
