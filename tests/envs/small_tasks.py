"""Tasks of other kinds than the library's: with masks, with two fish."""

from math import pi
from typing import Any, ClassVar

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from fishrl.envs import AbstractTask, Command


class GoLeft(AbstractTask):
    """Base: start at a random x in the middle of the domain, and swim to the left."""

    n_obs: ClassVar[int] = 2
    num_actions: ClassVar[int] = 2
    num_draws: ClassVar[int] = 1

    def starts_from(self, uniform: Tensor) -> TensorDict:
        head = torch.stack((4.0 + uniform[:, 0], torch.full_like(uniform[:, 0], 2.5)), -1)
        heading = torch.full_like(uniform[:, 0], pi)
        return TensorDict({"head": head * self.body_length, "heading": heading}, uniform.shape[:1])

    def measure(self, solver: Any, starts: TensorDictBase) -> TensorDict:
        fish = range(self.num_fish)
        x = torch.stack([solver.markers(i)[:, 0, 0] for i in fish], -1) / self.body_length
        heading = torch.stack([solver.bodies[i].heading for i in fish], -1)
        shape = (starts.shape[0], *(self.num_fish,) * (self.num_fish > 1))
        now = {"x": x.view(shape), "heading": heading.view(shape)}
        return TensorDict(now, starts.batch_size)

    def observe(self, now: TensorDictBase) -> Tensor:
        return torch.stack((now["x"], now["heading"]), -1).float()

    def reward(self, before: TensorDictBase, now: TensorDictBase) -> dict[str, Tensor]:
        return {"progress": before["x"] - now["x"]}

    def is_terminated(self, now: TensorDictBase) -> Tensor:
        return now["x"] < 1.0


class MaskedTask(GoLeft):
    """0 beats slower, 1 faster; neither beyond its limit."""

    checks_per_action: int = 40

    @property
    def max_frequency(self) -> float:
        return 2.0

    def command(self, action: Tensor, before: TensorDictBase) -> Command:
        change = (action.double() - 0.5) / self.scales.period
        return Command(frequency=before["frequency"] + change)

    def measure(self, solver: Any, starts: TensorDictBase) -> TensorDict:
        return super().measure(solver, starts).set("frequency", solver.body.frequency.clone())

    def observe(self, now: TensorDictBase) -> Tensor:
        return torch.stack((now["x"], now["frequency"] * self.scales.period), -1).float()

    def action_mask(self, now: TensorDictBase) -> Tensor:
        beats = now["frequency"] * self.scales.period
        return torch.stack((beats > 0.75, beats < 1.75), -1)

    def report(self, now: TensorDictBase) -> dict[str, Tensor]:
        return {"beats": now["frequency"] * self.scales.period}


class PairTask(GoLeft):
    """Two fish, the first above the second; 0 turns clockwise, 2 the other way, never twice."""

    num_actions: ClassVar[int] = 3
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
        return Command(turn=turn)

    def is_terminated(self, now: TensorDictBase) -> Tensor:
        return (now["x"] < 3.0).any(-1)

    def action_mask(self, now: TensorDictBase) -> Tensor:
        turned = now["heading"] - pi
        return torch.stack((turned > -0.3, turned < 9.0, turned < 0.3), -1)

    def report(self, now: TensorDictBase) -> dict[str, Tensor]:
        return {"arrived": now["x"] < 3.0}
