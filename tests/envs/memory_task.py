"""A task with sensor series, entries that persist between decisions, and an input."""

from math import pi
from typing import ClassVar

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from fishrl.envs import AbstractTask, Command
from fishrl.envs.extensions import HasHistory
from fishrl.physics.fast.solver import InPlaceSolver


class MemoryTask(AbstractTask, HasHistory):
    """Glide to the left: 0 straight on, 1 turn by the hint; sum up the actions."""

    n_obs: ClassVar[int] = 2
    num_actions: ClassVar[int] = 2
    num_draws: ClassVar[int] = 1
    num_samples: ClassVar[int] = 4
    inputs: ClassVar[tuple[str, ...]] = ("hint",)

    goal_bl: float = 1.0

    def starts_from(self, uniform: Tensor) -> TensorDict:
        head = torch.stack((3.0 + 2.0 * uniform[:, 0], torch.full_like(uniform[:, 0], 2.5)), -1)
        heading = torch.full_like(uniform[:, 0], pi)
        return TensorDict({"head": head * self.body_length, "heading": heading}, uniform.shape[:1])

    def command(self, action: Tensor, before: TensorDictBase) -> Command:
        return Command(action * before["hint"].double())

    def measure(self, solver: InPlaceSolver, starts: TensorDictBase) -> TensorDict:
        x = solver.markers()[:, 0, 0] / self.body_length
        return TensorDict({"x": x, "heading": solver.body.heading.clone()}, starts.batch_size)

    def sense(self, solver: InPlaceSolver, starts: TensorDictBase) -> dict[str, Tensor]:
        return {"trace": solver.markers()[:, :3, 0] / self.body_length}

    def begin(self, now: TensorDictBase) -> dict[str, Tensor]:
        return {"total": torch.zeros_like(now["x"]), "way": torch.zeros_like(now["x"])}

    def remember(
        self, before: TensorDictBase, action: Tensor, now: TensorDictBase
    ) -> dict[str, Tensor]:
        return {"total": before["total"] + action, "way": before["x"] - now["x"]}

    def observe(self, now: TensorDictBase) -> Tensor:
        return torch.stack((now["x"], now["total"]), -1).float()

    def reward(self, before: TensorDictBase, now: TensorDictBase) -> Tensor:
        way: Tensor = now["way"]
        return way

    def is_terminated(self, now: TensorDictBase) -> Tensor:
        return now["x"] < self.goal_bl

    def report(self, now: TensorDictBase) -> dict[str, Tensor]:
        return {"trace": now["trace"].float(), "total": now["total"]}
