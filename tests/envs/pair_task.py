"""Two fish that learn: each is rewarded for swimming to the left."""

from math import pi
from typing import ClassVar

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from fishrl.envs import AbstractTask, Command
from fishrl.physics.fast.solver import InPlaceSolver


class PairTask(AbstractTask):
    """The first fish starts above the second; 0 turns clockwise, 2 the other way, never twice."""

    n_obs: ClassVar[int] = 2
    num_actions: ClassVar[int] = 3
    num_draws: ClassVar[int] = 1
    num_fish: ClassVar[int] = 2

    is_continuous: bool = False
    gap_bl: float = 1.5

    @property
    def action_bounds(self) -> tuple[tuple[float, float], ...] | None:
        return ((-0.2, 0.2), (0.0, 0.0001), (0.0, 1.0)) if self.is_continuous else None

    def starts_from(self, uniform: Tensor) -> TensorDict:
        x = 4.0 + uniform.expand(-1, 2)
        y = 2.5 + self.gap_bl * torch.tensor([0.5, -0.5]).to(x)
        head = torch.stack((x, y.expand_as(x)), -1) * self.body_length
        return TensorDict({"head": head, "heading": torch.full_like(x, pi)}, uniform.shape[:1])

    def command(self, action: Tensor, before: TensorDictBase) -> Command:
        turn = action[..., 0] if self.is_continuous else 0.2 * (action.double() - 1.0)
        return Command(turn)

    def measure(self, solver: InPlaceSolver, starts: TensorDictBase) -> TensorDict:
        x = [solver.markers(index)[:, 0, 0] for index in range(2)]
        turn = [body.heading for body in solver.bodies]
        now = {"x": torch.stack(x, 1) / self.body_length, "heading": torch.stack(turn, 1)}
        return TensorDict(now, starts.batch_size)

    def observe(self, now: TensorDictBase) -> Tensor:
        return torch.stack((now["x"], now["heading"]), -1).float()

    def reward(self, before: TensorDictBase, now: TensorDictBase) -> Tensor:
        return before["x"] - now["x"]

    def is_terminated(self, now: TensorDictBase) -> Tensor:
        return (now["x"] < 3.0).any(-1)

    def action_mask(self, now: TensorDictBase) -> Tensor:
        turned = now["heading"] - pi
        return torch.stack((turned > -0.3, turned < 9.0, turned < 0.3), -1)

    def report(self, now: TensorDictBase) -> dict[str, Tensor]:
        return {"arrived": now["x"] < 3.0}
