"""Counters and metrics of a run."""

from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import psutil
from tensordict import TensorDictBase

from fishrl.envs import AbstractTask
from fishrl.envs.agents import average_fish
from fishrl.envs.episodes import has_succeeded

#: Episodes that the training return and rate of success are averaged over.
WINDOW = 32


def list_metrics(
    losses: tuple[str, ...], counted: Iterable[str] = (), terms: Iterable[str] = ()
) -> tuple[str, ...]:
    """List the columns of metrics.csv.

    Arguments are the losses of the algorithm, and the task's counted flags and reward terms.
    ``train/`` describes the last episodes or the last gradient step, ``eval/`` the greedy policy
    from fixed starts, ``time/`` this machine. The seed determines all but ``time/``.
    """
    of_eval = ("success_rate", "mean_return", "mean_length_T", "mean_time_to_success_T")
    of_time = ("wall_seconds", "frames_per_second", "mlups", "memory_mb")
    return (
        *Counters().metrics(),
        *(f"train/{name}" for name in losses),
        *(f"eval/{name}" for name in (*of_eval, "episodes", "diverged")),
        *(f"eval/{name}_rate" for name in counted),
        *(f"eval/{name}" for name in terms),
        *(f"time/{name}" for name in of_time),
    )


@dataclass
class Counters:
    """Counters of a run.

    ``losses`` come from the last gradient step and are cleared once logged. ``pending`` are metrics
    of the newest frames, not yet complete; a resumed run completes them.
    """

    frames: int = 0
    updates: int = 0
    episodes: int = 0
    diverged: int = 0
    wall_seconds: float = 0.0
    collect_seconds: float = 0.0
    best: list[float] = field(default_factory=list)
    recent: deque[list[float]] = field(default_factory=lambda: deque(maxlen=WINDOW))
    losses: dict[str, float] = field(default_factory=dict)
    pending: dict[str, float] = field(default_factory=dict)

    def state_dict(self) -> dict[str, Any]:
        """Return plain numbers and lists."""
        return {**vars(self), "recent": list(self.recent), "pending": dict(self.pending)}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore a state of ``state_dict``."""
        vars(self).update(state, recent=deque(state["recent"], maxlen=WINDOW))

    def count(self, transitions: TensorDictBase, *, success: str | None) -> None:
        """Count the episodes that end in transitions ``[N]``; diverged ones are no episodes."""
        after = transitions["next"]
        has_ended = (after["done"] & ~after["diverged"]).reshape(-1)
        ended = after[has_ended]
        returns = average_fish(ended, "episode_reward")
        columns = (returns, has_succeeded(ended, success), ended["step_count"])
        for numbers in zip(*(column.reshape(-1).tolist() for column in columns), strict=True):
            self.episodes += 1
            self.recent.append([float(number) for number in numbers])

    def metrics(self) -> dict[str, float]:
        """Return the metrics that need no gradient step."""
        recent = np.array(self.recent) if self.recent else np.full((1, 3), np.nan)
        return {
            "frames": self.frames,
            "train/episodes": self.episodes,
            "train/return": float(recent[:, 0].mean()),
            "train/success_rate": float(recent[:, 1].mean()),
            "train/episode_length": float(recent[:, 2].mean()),
            "train/diverged": self.diverged,
            "train/updates": self.updates,
        }


def compute_mlups(task: AbstractTask, num_frames: int, seconds: float) -> float:
    """Return million lattice node updates per second, with sensing and policy included."""
    num_updates = task.flow_config().updates_per_step * task.n_substeps * num_frames
    return num_updates / max(seconds, 1e-9) / 1e6


def measure_memory_mb() -> float:
    """Return the memory of this process that no other one shares, in MB."""
    return float(psutil.Process().memory_full_info().uss) / 1e6
