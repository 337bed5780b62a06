"""One episode, kept frame by frame: what the figures and the viewer draw."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields
from os import PathLike
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase
from torchrl.envs.utils import ExplorationType, set_exploration_type

from fishrl.physics.diagnostics import compute_vorticity


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
) -> list[Recording]:
    """Run one episode from each start, all side by side, and keep what there is to see.

    The last frame of an episode is the very look at which it ended. A flow that diverges is kept up
    to the decision before.

    Args:
        env: of a task with food, made with ``frames_per_action=task.checks_per_action``;
            what it does at the moment is given up. The env of a training that is over will do.
        policy: writes ``action``; a learned one acts greedily.
        starts: ``[E]``, no more than the env has flows.
        frames_per_T: frames per period, about: one of every so many looks that the task takes.
        on_episodes: called with the number of episodes that have just ended.

    Returns:
        E recordings, in the order of their starts.
    """
    num_starts, base = starts.shape[0], env.base_env
    if frames_per_T < 1:
        raise ValueError(f"frames_per_T = {frames_per_T}: at least one frame per period is needed")
    if num_starts > base.batch_size[0]:
        raise ValueError(
            f"{num_starts} starts, but the env has {base.batch_size[0]} flows: give no more starts"
        )
    base.task.check_starts(starts)
    before = base.starts, base.on_frame
    base.starts = starts
    try:
        with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
            state = env.reset()
            row_of = {start: row for row, start in enumerate(state["start_index"].tolist())}
            recorder = _Recorder(base.task, rows=row_of.values(), frames_per_T=frames_per_T)
            recorder.keep(base)
            base.on_frame = recorder.look
            while recorder.running:
                step, state = env.step_and_maybe_reset(policy(state))
                num_ended = recorder.settle(step)
                if on_episodes is not None and num_ended:
                    on_episodes(num_ended)
    finally:
        base.starts, base.on_frame = before
    return [recorder.finish(row_of[start]) for start in range(num_starts)]


class _Recorder:
    """Collects frames row by row until the first episode of each is over.

    Args:
        task: whose flows these are.
        rows: which flows to keep.
        frames_per_T: frames per period, about.
    """

    def __init__(self, task: Any, *, rows: Iterable[int], frames_per_T: int) -> None:
        self.task = task
        looks_per_T = task.checks_per_action * task.scales.period / task.n_substeps
        self.stride = max(1, round(looks_per_T / frames_per_T))
        self.frames_per_T = max(1, round(looks_per_T / self.stride))
        self.running = set(rows)
        self.captured = dict.fromkeys(self.running, False)
        self._frames: dict[int, list[dict[str, Tensor]]] = {row: [] for row in self.running}
        # Frames of the action under way: its reward is known only when it is over.
        self._pending: dict[int, list[dict[str, Tensor]]] = {row: [] for row in self.running}
        self._open = set(self.running)
        self._num_looks = 0

    def look(self, env: Any) -> None:
        """Look at the flows within an action: keep every so many, and every end of an episode."""
        self._num_looks += 1
        has_ended = self.task.is_terminated(env.measure()).tolist()
        ending = {row for row in self._open if has_ended[row]}
        self.keep(env, self._open if self._num_looks % self.stride == 0 else ending)
        self._open -= ending

    def keep(self, env: Any, rows: set[int] | None = None) -> None:
        """Keep a frame of some rows, of all by default."""
        rows = self.running if rows is None else rows
        if not rows:
            return
        now, markers, age = env.measure(), env.solver.markers(), env.solver.body.age
        period = self.task.scales.period
        vorticity = compute_vorticity(env.solver.macroscopic()[1]) * period
        frame = {
            "time": age / period,
            "outline": markers.float(),
            "vorticity": vorticity.half(),
            "food": now["food"].float(),
            "head": now["head"].float(),
            "heading": now["heading"].float(),
        }
        for row in rows:
            self._pending[row].append({name: v[row].cpu().clone() for name, v in frame.items()})

    def settle(self, step: TensorDictBase) -> int:
        """Give the frames of an action that is over their action and reward.

        Returns:
            The number of episodes that it ended.
        """
        after = step["next"]
        ended = set()
        for row in self.running:
            action, reward = step["action"][row].cpu(), after["reward"][row].sum().cpu()
            if not after["diverged"][row].any():
                self._frames[row] += [
                    {**frame, "action": action, "reward": reward} for frame in self._pending[row]
                ]
            elif not self._frames[row]:
                # diverged at once: the start is all there is
                self._frames[row] = [{**self._pending[row][0], "action": action, "reward": reward}]
            self._pending[row] = []
            if after["done"][row].any():
                ended.add(row)
                self.captured[row] = bool(after["captured"][row].any())
        self.running -= ended
        self._open = set(self.running)
        return len(ended)

    def finish(self, row: int) -> Recording:
        """Return what was kept of a row."""
        frames, task = self._frames[row], self.task
        config = task.flow_config()
        kept = {name: torch.stack([frame[name] for frame in frames]) for name in frames[0]}
        self._frames[row] = []
        return Recording(
            body_length=float(task.scales.body_length),
            period=task.scales.period,
            domain=(config.width, config.height),
            frames_per_T=self.frames_per_T,
            capture_radius=float(task.capture_radius),
            captured=self.captured[row],
            **kept,
        )
