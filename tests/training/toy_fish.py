"""A point fish with the keys of the real environment, for tests that need thousands of steps.

It swims straight at 0.4 body lengths per decision, turns on the spot spread over the decision, and
hunts food that moves up and down. Walls at the sides of a 10 x 5 body-length basin end an episode.
"""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, ClassVar

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Bounded, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase, TransformedEnv

from fishrl.envs import Flows, Predation, make_env
from fishrl.envs.mirror import Mirror
from fishrl.envs.sense import Sense

STATE = ("position", "heading", "food", "direction", "age", "distance", "error", "start_index")


class ToyPredation(Predation):
    """Predation whose flows are played by a point fish."""

    known_senses: ClassVar[dict[str, Sense]] = {
        "heading": Sense("heading", ("sine", "cosine"), lambda now: now["heading"])
    }
    mirror: ClassVar[Mirror] = Mirror((1, -2, 3, -4), (-1, 2), (2, 1, 0))

    capture_radius_bl: float = 0.4
    critic_num_stacked: int = 2
    divergence_rate: float = 0.0
    banned_action: int = -1
    is_continuous: bool = False

    @property
    def num_actions(self) -> int:
        return 2 if self.is_continuous else 3

    @property
    def action_bounds(self) -> tuple[tuple[float, float], ...] | None:
        return ((-15.0, 15.0), (0.5, 1.0)) if self.is_continuous else None

    def sample_starts(self, num: int, generator: torch.Generator) -> TensorDict:
        draw = torch.rand(num, 2, generator=generator)
        position = torch.tensor([5.0, 1.0]) + draw * torch.tensor([2.5, 3.0])
        return TensorDict({"position": position}, [num])


class ToyFishEnv(EnvBase):
    """All fish of the batch at once."""

    starts: TensorDict | None = None

    def __init__(self, *, task: ToyPredation, flows: Flows, seed: int, **_: Any) -> None:
        num_envs = flows.num_envs
        super().__init__(device="cpu", batch_size=[num_envs])
        self.task = task
        self.rng = torch.Generator().manual_seed(seed)
        self.next_start = 0
        self.on_frame = None
        flag = Binary(1, dtype=torch.bool)
        masked = {} if task.is_continuous else {"action_mask": Binary(3, dtype=torch.bool)}
        self.observation_spec_unbatched = Composite(
            observation=Unbounded((4,)),
            **masked,
            **({"critic_observation": Unbounded((2,))} if task.critic_senses else {}),
            diverged=flag,
            captured=flag.clone(),
            food_ahead=Unbounded((160, 2)),
            start_index=Unbounded((), dtype=torch.int64),
        )
        self.action_spec_unbatched = (
            Bounded(-1.0, 1.0, (2,)) if task.is_continuous else Categorical(3)
        )
        self.reward_spec_unbatched = Unbounded((1,))
        for name in STATE:
            self.register_buffer(name, torch.zeros(num_envs))
        self.position, self.food = torch.zeros(num_envs, 2), torch.zeros(num_envs, 2)
        self.start_index = torch.full((num_envs,), -1)
        self.is_resting = torch.zeros(num_envs, dtype=torch.bool)

    @contextmanager
    def set_starts(self, starts: TensorDict, *, on_frame: Any = None) -> Iterator[None]:
        before, self.starts, self.next_start = self.starts, starts, 0
        yield
        self.starts, self.is_resting = before, torch.zeros_like(self.is_resting)

    def get_extra_state(self) -> dict[str, Any]:
        return {"rng": self.rng.get_state(), "next_start": torch.tensor(self.next_start)}

    def set_extra_state(self, state: dict[str, Any]) -> None:
        self.rng.set_state(state["rng"])
        self.next_start = int(state["next_start"])

    def _set_seed(self, seed: int | None) -> None:
        self.rng.manual_seed(seed or 0)

    def _sense(self) -> Tensor:
        away = self.food - self.position
        bearing = torch.atan2(away[:, 1], away[:, 0]) - self.heading
        error = torch.atan2(bearing.sin(), bearing.cos())
        return torch.stack((*away.unbind(-1), away.norm(dim=-1), error), -1)

    def _observe(self, **flags: Tensor) -> dict[str, Tensor]:
        mask = torch.ones(self.batch_size[0], 3, dtype=torch.bool)
        if self.task.banned_action >= 0:
            mask[:, self.task.banned_action] = False
        starts = TensorDict({"food_direction": torch.ones_like(self.age)}, self.batch_size)
        ahead = self.task.foresee_food(starts, self.age * self.task.scales.period)
        heading = torch.stack((self.heading.sin(), self.heading.cos()), -1)
        return {
            "observation": self._sense(),
            **({"critic_observation": heading} if self.task.critic_senses else {}),
            **({} if self.task.is_continuous else {"action_mask": mask}),
            "start_index": self.start_index.clone(),
            "food_ahead": (ahead / self.task.body_length).float(),
            **{name: flag.unsqueeze(-1) for name, flag in flags.items()},
        }

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDict:
        rows = torch.ones(self.batch_size, dtype=torch.bool)
        if tensordict is not None and "_reset" in tensordict:
            rows = tensordict["_reset"].reshape(self.batch_size)
        num = int(rows.sum())
        if self.starts is None:
            drawn = self.task.sample_starts(num, self.rng)
            self.start_index[rows] = -1
        else:
            index = (self.next_start + torch.arange(num)) % self.starts.shape[0]
            self.next_start += num
            drawn = self.starts[index]
            self.start_index[rows] = index
        self.position[rows] = drawn["position"]
        self.food[rows] = torch.tensor([2.5, 2.5])
        self.heading[rows], self.direction[rows], self.age[rows] = math.pi, 1.0, 0.0
        distance, error = self._sense()[:, 2:].unbind(-1)
        self.distance[rows], self.error[rows] = distance[rows], error.abs()[rows]
        none = torch.zeros(self.batch_size, dtype=torch.bool)
        flags = {n: none.unsqueeze(-1).clone() for n in ("done", "terminated", "truncated")}
        return TensorDict({**self._observe(diverged=none, captured=none), **flags}, self.batch_size)

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        action, speed = tensordict["action"], torch.ones_like(self.heading)
        if self.task.is_continuous:
            share, speed = action[:, 0], 0.75 + 0.25 * action[:, 1]
        else:
            share = action.float() - 1.0
        turn = share * math.radians(15.0)
        middle = self.heading + 0.5 * turn
        self.position += 0.4 * speed[:, None] * torch.stack([middle.cos(), middle.sin()], -1)
        self.heading += turn
        self.age += 1.0
        moves = self.task.food_speed_bl * (self.age > 5.0) * self.direction
        self.food[:, 1] += moves
        self.direction = torch.where(self.food[:, 1] > 3.5, -1.0, self.direction)
        self.direction = torch.where(self.food[:, 1] < 1.5, 1.0, self.direction)
        distance, error = self._sense()[:, 2:].unbind(-1)
        nearer = (distance < self.distance) | (error.abs() < self.error)
        self.distance, self.error = distance, error.abs()
        captured = distance < self.task.capture_radius_bl
        x, y = self.position.unbind(-1)
        hits_wall = (x < 0.5) | (x > 9.5) | (y < 0.3) | (y > 4.7)
        diverged = (
            torch.rand(self.batch_size, generator=self.rng) < self.task.divergence_rate
        ) & ~captured
        terminated = ((captured | hits_wall) & ~diverged).unsqueeze(-1)
        reward = torch.where(nearer, 1.0, -1.0) + 20.0 * captured
        return TensorDict(
            {
                **self._observe(diverged=diverged, captured=captured),
                "reward": reward.masked_fill(diverged, 0.0).unsqueeze(-1),
                "terminated": terminated,
                "truncated": diverged.unsqueeze(-1),
                "done": terminated | diverged.unsqueeze(-1),
            },
            self.batch_size,
        )


def make_any_env(*, task: Any, **given: Any) -> TransformedEnv:
    """Make flows of a task, also of the point fish, in whichever process."""
    with pytest.MonkeyPatch.context() as patch:
        if isinstance(task, ToyPredation):
            patch.setattr("fishrl.envs.making.FlowEnv", ToyFishEnv)
        return make_env(task=task, **given)
