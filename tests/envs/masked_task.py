"""A task of another kind than those of the library: it bans actions and sets the tail beat."""

from math import pi
from typing import ClassVar

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from fishrl.envs import AbstractTask, Command
from fishrl.physics.fast.solver import InPlaceSolver


class MaskedTask(AbstractTask):
    """Get away from the right wall: 0 beats slower, 1 faster; neither beyond its limit."""

    n_obs: ClassVar[int] = 2
    num_actions: ClassVar[int] = 2
    num_draws: ClassVar[int] = 1

    checks_per_action: int = 40

    @property
    def max_frequency(self) -> float:
        return 2.0

    def starts_from(self, uniform: Tensor) -> TensorDict:
        head = torch.stack((4.0 + uniform[:, 0], torch.full_like(uniform[:, 0], 2.5)), -1)
        heading = torch.full_like(uniform[:, 0], pi)
        return TensorDict({"head": head * self.body_length, "heading": heading}, uniform.shape[:1])

    def command(self, action: Tensor, before: TensorDictBase) -> Command:
        change = (action.double() - 0.5) / self.scales.period
        return Command(torch.zeros_like(change), before["frequency"] + change)

    def measure(self, solver: InPlaceSolver, starts: TensorDictBase) -> TensorDict:
        x = solver.markers()[:, 0, 0] / self.body_length
        return TensorDict({"x": x, "frequency": solver.body.frequency.clone()}, starts.batch_size)

    def observe(self, now: TensorDictBase) -> Tensor:
        return torch.stack((now["x"], now["frequency"] * self.scales.period), -1).float()

    def reward(self, before: TensorDictBase, now: TensorDictBase) -> Tensor:
        return before["x"] - now["x"]

    def is_terminated(self, now: TensorDictBase) -> Tensor:
        return now["x"] < 1.0

    def action_mask(self, now: TensorDictBase) -> Tensor:
        beats = now["frequency"] * self.scales.period
        return torch.stack((beats > 0.75, beats < 1.75), -1)

    def report(self, now: TensorDictBase) -> dict[str, Tensor]:
        return {"beats": now["frequency"] * self.scales.period}
