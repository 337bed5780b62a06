"""What a task is: the page to read before writing one.

A task says where fish start, what an action orders, what is measured, and what observation, reward
and end follow from the measurement. It never loops over the batch: everything is a tensor or a
TensorDict with a leading batch axis B, and rows differ by masks (``torch.where``). It keeps no
state: what lasts from one decision to the next is in the flow, in the starts or in the last
measurement, to which ``sense``, ``begin`` and ``remember`` add what a task needs beyond the moment.
The environment does the rest: specs, resets, sub-steps, divergence, saving.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, NamedTuple, final

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from fishrl.envs.schedule import make_schedule
from fishrl.envs.starts import check_fit, check_pattern, place_fish
from fishrl.physics.bodies.fish import Fish
from fishrl.physics.fast.solver import InPlaceSolver
from fishrl.physics.flow import FlowConfig
from fishrl.physics.units import DEFAULT_WALL_SPEED, Scales


class Command(NamedTuple):
    """What an action orders for one control interval.

    Attributes:
        turn: ``[B]`` change of heading in radians, spread smoothly over the interval.
        frequency: ``[B]`` tail beats per step, or None to keep it.
    """

    turn: Tensor
    frequency: Tensor | None = None


@dataclass(frozen=True, kw_only=True)
class AbstractTask(ABC):
    """A fish in still water between walls, deciding once per interval; subclasses say what for.

    Class attributes of every task: ``n_obs``, numbers in one observation; ``num_actions``; and
    ``num_draws``, random numbers that one start takes. Of some: ``success``, name of the entry of
    ``report`` that tells whether the task is accomplished (by default, "survived", there is none:
    lasting until the time limit is success); ``inputs``, names of
    entries ``[B]`` that a transform writes and ``command`` finds in the measurement; and
    ``num_samples``, how often ``sense`` is called within an action.

    Args:
        body_length: L in nodes; at Reynolds number 7000 at least 50 for an honest swimming speed.
        reynolds: Re_f = L^2 / (T nu).
        max_wall_speed: budget for the tail's speed, nodes per step; sets the period T.
        domain_bl: width and height of the domain in body lengths.
        wall_margin_bl: how near a marker may come to the edge, in body lengths.
        num_stacked: observations that the fish remembers, the present one included.
        time_limit: decisions after which an episode is truncated.
        control_interval_T: time from one decision to the next, in periods T.
        checks_per_action: how often within an action the ends of the episode are looked for.
    """

    n_obs: ClassVar[int]
    num_actions: ClassVar[int]
    num_draws: ClassVar[int]
    success: ClassVar[str] = "survived"
    inputs: ClassVar[tuple[str, ...]] = ()
    num_samples: ClassVar[int] = 0

    body_length: int = 50
    reynolds: float = 7000.0
    max_wall_speed: float = DEFAULT_WALL_SPEED
    domain_bl: tuple[float, float] = (10.0, 5.0)
    wall_margin_bl: float = 0.1
    num_stacked: int = 4
    time_limit: int = 30
    control_interval_T: float = 1.0
    checks_per_action: int = 25

    def __post_init__(self) -> None:
        """Refuse what cannot be run; turns sequences from files into tuples."""
        for name in ("n_obs", "num_actions", "num_draws"):
            if not hasattr(type(self), name):
                raise ValueError(f"{type(self).__name__} has no {name}: give it as a ClassVar[int]")
        object.__setattr__(self, "domain_bl", as_pair("domain_bl", self.domain_bl))
        for name in ("num_stacked", "time_limit"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} = {getattr(self, name)}: must be at least 1")
        if not 0.0 < self.control_interval_T <= 10.0:
            raise ValueError(
                f"control_interval_T = {self.control_interval_T}: allowed is above 0, up to 10"
            )
        stretches = make_schedule(
            self.n_substeps, checks=self.checks_per_action, samples=self.num_samples
        )
        self.flow_config()  # refuses a domain too small for the fish
        # A marker must not pass from the margin out of the grid between two checks; swimming and
        # turning add at most as much again to the tail's speed.
        travel = 2.0 * self.scales.tail_speed * max(s.num_steps for s in stretches)
        least = 1.0 + travel
        if self.wall_margin < least:
            raise ValueError(
                f"wall_margin_bl = {self.wall_margin_bl} is {self.wall_margin:.1f} nodes, too few: "
                f"markers may move {travel:.1f} between two checks; raise it to at least "
                f"{least / self.body_length:.3f}, or raise checks_per_action"
            )

    @cached_property
    def scales(self) -> Scales:
        """Lattice units of the task."""
        return Scales.from_budget(
            body_length=self.body_length,
            reynolds=self.reynolds,
            max_wall_speed=self.max_wall_speed,
        )

    @cached_property
    def fish(self) -> Fish:
        """The body."""
        return Fish(body_length=self.body_length)

    @property
    def n_substeps(self) -> int:
        """Steps per action, an even number."""
        return 2 * max(1, round(0.5 * self.control_interval_T * self.scales.period))

    @property
    def interval_T(self) -> float:
        """Duration of an action in periods T: ``control_interval_T`` in whole steps."""
        return self.n_substeps / self.scales.period

    @property
    def wall_margin(self) -> float:
        """How near a marker may come to the edge, in nodes."""
        return self.wall_margin_bl * self.body_length

    def flow_config(self) -> FlowConfig:
        """Return the flow: a closed tank of still water unless a task overrides this."""
        width, height = (round(size * self.body_length) for size in self.domain_bl)
        return FlowConfig(width=width, height=height, tau=self.scales.tau, bodies=(self.fish,))

    @final
    def make_solver(
        self, *, num_envs: int, device: torch.device | str, compile: bool
    ) -> InPlaceSolver:
        """Return ``num_envs`` flows of this task."""
        return InPlaceSolver(
            config=self.flow_config(),
            num_envs=num_envs,
            frequency=1.0 / self.scales.period,
            device=device,
            compile=compile,
        )

    @abstractmethod
    def starts_from(self, uniform: Tensor) -> TensorDict:
        """Turn random numbers into starts.

        Args:
            uniform: ``[E, num_draws]`` in [0, 1), float64.

        Returns:
            TensorDict ``[E]`` with ``head`` ``[E, 2]`` (x, y) in nodes and ``heading`` ``[E]`` in
            radians, both float64, and whatever else tells one episode from another.
        """

    @final
    def sample_starts(self, num: int, generator: torch.Generator) -> TensorDict:
        """Draw ``num`` starts ``[E]``."""
        return self.starts_from(
            torch.rand(num, self.num_draws, generator=generator, dtype=torch.float64)
        )

    def check_starts(self, starts: TensorDictBase) -> None:
        """Refuse starts ``[E]`` of wrong shape, outside the domain, or where the fish does not fit.

        Raises:
            ValueError: naming the first of them.
        """
        check_pattern(starts, self.starts_from(torch.zeros(1, self.num_draws, dtype=torch.float64)))
        config = self.flow_config()
        check_fit(
            starts, self.fish, width=config.width, height=config.height, margin=self.wall_margin
        )

    def place_(self, solver: InPlaceSolver, rows: Tensor, starts: TensorDictBase) -> None:
        """Let episodes begin: put fish into their flows; still water unless a task overrides this.

        Args:
            solver: the flows.
            rows: ``[B]`` bool, which of them; others must not be touched.
            starts: ``[B]``, read where ``rows`` is true.
        """
        position, heading = place_fish(starts, self.fish)
        solver.reset_(rows, position, heading)

    @abstractmethod
    def command(self, action: Tensor, before: TensorDictBase) -> Command:
        """Turn actions ``[B]`` (int64, in [0, num_actions)) into orders to the body.

        Args:
            action: legal ones only.
            before: the measurement ``[B]`` at the decision, with what was sensed and remembered,
                and ``inputs``.
        """

    @abstractmethod
    def measure(self, solver: InPlaceSolver, starts: TensorDictBase) -> TensorDict:
        """Return everything that observation, reward and ends are made of, as TensorDict ``[B]``.

        It is called several times within an action; a row keeps the first measurement that ends its
        episode, or else the last one. Copies only: the solver's own tensors change in place.

        Args:
            solver: the flows; ``solver.body.age`` counts the steps since reset.
            starts: the start of each row, ``[B]``.
        """

    def sense(self, solver: InPlaceSolver, starts: TensorDictBase) -> dict[str, Tensor]:
        """Return ``[B, ...]`` tensors of which a series is kept within each action.

        It is called ``num_samples`` = W times within an action, at equal distances, the last time
        at its end. The measurement at the next decision holds them as ``[B, W, ...]``, oldest
        first; at reset all W are the first. After a row's end its last sample is repeated.
        """
        return {}

    def begin(self, now: TensorDictBase) -> dict[str, Tensor]:
        """Return ``[B, ...]`` what the measurement shall hold beside it when an episode begins."""
        return {}

    def remember(
        self, before: TensorDictBase, action: Tensor, now: TensorDictBase
    ) -> dict[str, Tensor]:
        """Return the same entries after an action; reward and observation see them in ``now``.

        Args:
            before: the measurement at the decision, as ``command`` saw it.
            action: ``[B]``, legal ones only.
            now: the new measurement, with what was sensed.
        """
        return {}

    @abstractmethod
    def observe(self, now: TensorDictBase) -> Tensor:
        """Return the observation ``[B, n_obs]``, float32."""

    @abstractmethod
    def reward(self, before: TensorDictBase, now: TensorDictBase) -> Tensor:
        """Return the reward ``[B]`` for what happened between two measurements."""

    @abstractmethod
    def is_terminated(self, now: TensorDictBase) -> Tensor:
        """Return ``[B]`` bool: whether the task is over, by success or failure (not by time).

        It is asked within actions too, of what ``measure`` alone returns.
        """

    def action_mask(self, now: TensorDictBase) -> Tensor:
        """Return ``[B, num_actions]`` bool: the legal actions, at least one, at the end too."""
        return torch.ones(*now.shape, self.num_actions, dtype=torch.bool, device=now.device)

    def report(self, now: TensorDictBase) -> dict[str, Tensor]:
        """Return ``[B, ...]`` tensors that the environment shall write beside the observation."""
        return {}


def as_pair(name: str, value: object) -> tuple[float, float]:
    """Return two numbers as a tuple; a list from a file will do.

    Raises:
        ValueError: if it is anything else.
    """
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise ValueError(f"{name} = {value}: give two numbers")
    return float(value[0]), float(value[1])
