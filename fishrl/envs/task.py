"""The interface of a task; read this before writing one.

A task defines where fish start, what an action commands, what is measured, and how observation,
reward and termination follow from the measurement. Everything is a tensor or TensorDict with a
leading batch axis B; there are no loops over the batch, and rows are distinguished by masks
(``torch.where``). Where none is read on the host, a decision on a GPU is one graph. A task keeps no
state: what persists between decisions is in the flow, in the starts or in the last measurement. The
environment handles specs, resets, sub-steps, divergence and checkpoints. Optional bases, such as
sensor series, memory and flow labels, are in ``fishrl.envs.extensions``. Names end in ``_bl`` for
body lengths L, in ``_T`` for periods T, in an underscore for what changes its object in place.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from functools import cached_property
from itertools import pairwise
from math import ceil
from typing import Annotated, Any, ClassVar

import torch
from pydantic import Field, PositiveFloat, PositiveInt
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from fishrl.envs.command import Command
from fishrl.envs.extensions import HasHistory, find_extension
from fishrl.envs.mirror import Mirror, join_mirrors
from fishrl.envs.schedule import make_schedule
from fishrl.envs.sense import Sense, choose_critic_senses, count_numbers, read_senses
from fishrl.envs.starts import check_fit, check_pattern, place_fish
from fishrl.physics.bodies.fish import Fish
from fishrl.physics.bodies.motion import Bending
from fishrl.physics.bodies.outline import BodyConfig
from fishrl.physics.fast.solver import InPlaceSolver
from fishrl.physics.flow import FlowConfig
from fishrl.physics.lattice import MAX_IMPOSED_SPEED
from fishrl.physics.levels.patch import Patch
from fishrl.physics.skins import BounceBack, Skin
from fishrl.physics.units import DEFAULT_WALL_SPEED, Scales
from fishrl.settings import Settings

_Size = Annotated[float, Field(gt=0, le=1e6)]


class AbstractTask(Settings, ABC):
    """Base of all tasks: a fish in a tank of still water with one decision per control interval.

    A task lists its ``senses``, or defines ``n_obs`` and ``observe``. Sizes may be given as class
    attributes, ``n_obs: ClassVar[int] = 3``.

    Args:
        body_length: L in nodes; at Reynolds number 7000 at least 50 for a useful swimming speed.
        reynolds: Re_f = L^2 / (T nu).
        max_wall_speed: largest speed of the beating tail, nodes per step; sets the period T.
        skin: how fish and water act on each other: ``bounce-back``, a sharp skin, or
            ``immersed-boundary``, the paper's; see the page on resolution.
        levels: grids of different spacing; with 2, only the water around the bodies, or where they
            may meet, has the spacing that L is in, the rest twice that, and with 3 the rest four
            times. T, the actions and the domain are rounded to what this takes.
        domain_bl: width and height of the domain in body lengths.
        wall_margin_bl: smallest distance of a marker from the edge, in body lengths; with levels,
            which keep a patch off the edge, larger if need be (``wall_margin``).
        num_stacked: stacked observations, the current one included.
        time_limit: decisions after which an episode is truncated.
        control_interval_T: time between decisions, in periods T.
        checks_per_action: checks for termination within one action.
        critic_observes: what critics read in training, besides the stack of the policy: names of
            ``known_senses``. Policies run without.
        critic_num_stacked: stacked observations of ``critic_observes``.
        critic_reads_stack: whether critics read the stack of the policy, too; without its history
            they are biased (Baisero & Amato 2022, arXiv 2105.11674).
    """

    former: ClassVar[Mapping[str, str]] = {
        "coupling": "give skin=bounce-back or skin=immersed-boundary, in Python skin=BounceBack()"
    }

    body_length: Annotated[int, Field(ge=16, le=100_000)] = 50
    reynolds: PositiveFloat = 7000.0
    max_wall_speed: PositiveFloat = DEFAULT_WALL_SPEED
    skin: Skin = BounceBack()
    levels: Annotated[int, Field(ge=1, le=6)] = 1
    domain_bl: tuple[_Size, _Size] = (10.0, 5.0)
    wall_margin_bl: Annotated[float, Field(ge=0, le=1e6)] = 0.1
    num_stacked: Annotated[int, Field(ge=1, le=10_000)] = 4
    time_limit: PositiveInt = 30
    control_interval_T: Annotated[float, Field(gt=0, le=10)] = 1.0
    checks_per_action: PositiveInt = 25
    critic_observes: tuple[str, ...] = ()
    critic_num_stacked: Annotated[int, Field(ge=1, le=10_000)] = 4
    critic_reads_stack: bool = True

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        both = {"is_terminated", "count_safe_steps"}
        nearest = next(base for base in cls.__mro__ if both & vars(base).keys())
        if "count_safe_steps" not in vars(nearest):  # those of its base know other ends only
            cls.count_safe_steps = AbstractTask.count_safe_steps  # type: ignore[method-assign]

    def __post_init__(self) -> None:
        if not (self.critic_senses or self.critic_reads_stack):
            raise ValueError("critic_reads_stack = False: critics need critic_observes then")
        least = self._least_margin  # raises for checks and samples that do not fit into an action
        self.flow_config()  # raises if the domain is too small for the fish
        if self.wall_margin < least:
            raise ValueError(
                f"wall_margin_bl = {self.wall_margin_bl} is {self.wall_margin:.2f} nodes: must be "
                f"{least + 0.005:.2f} or more, as markers move between two checks; raise it to at "
                f"least {ceil(1e3 * least / self.body_length) / 1e3:g}, or raise checks_per_action"
            )

    def __getstate__(self) -> dict[str, Any]:
        """Leave out of copies and pickles what follows from the settings, such as wakes."""
        cls = type(self)
        return {
            name: value
            for name, value in vars(self).items()
            if not isinstance(getattr(cls, name, None), cached_property)
        }

    @property
    def senses(self) -> tuple[Sense, ...]:
        """Parts of the observation, in their order."""
        return ()

    @property
    def known_senses(self) -> Mapping[str, Sense]:
        """Senses that ``critic_observes`` may name; by default those of the policy."""
        return {sense.name.replace(" ", "_"): sense for sense in self.senses}

    @property
    def critic_senses(self) -> tuple[Sense, ...]:
        """What critics read in training and policies do not; by default ``critic_observes``."""
        return choose_critic_senses(self.critic_observes, self.known_senses)

    @property
    def mirrored_actions(self) -> tuple[int, ...]:
        """Mirror images of the actions about the flow's horizontal axis, see ``Mirror``.

        Raises:
            ValueError: if the mirror image of the task is another task, as by default.
        """
        raise ValueError(
            f"reflect: {type(self).__name__} has no mirror image; give its mirrored_actions and "
            "Sense(mirror=...) if flow and reward are symmetric, or reflect=false"
        )

    @property
    def mirror(self) -> Mirror:
        """Its mirror image, with which ``reflect`` reflects transitions; errors as above."""
        actions, is_discrete = self.mirrored_actions, self.action_bounds is None
        mirror = Mirror(join_mirrors(self.senses), join_mirrors(self.critic_senses), actions)
        return mirror.check(
            num_obs=self.n_obs, num_actions=self.num_actions, is_discrete=is_discrete
        )

    @property
    def n_obs(self) -> int:
        """Length of one observation."""
        return count_numbers(self.senses)

    @property
    @abstractmethod
    def num_actions(self) -> int:
        """Number of discrete actions, or of components of a continuous one."""

    @property
    def action_bounds(self) -> tuple[tuple[float, float], ...] | None:
        """Lower and upper bound of each component of a continuous action, in its own unit.

        None, the default, means discrete actions. Policies write each component in [-1, 1], and the
        environment maps it to these bounds.
        """
        return None

    @property
    @abstractmethod
    def num_draws(self) -> int:
        """Random numbers per start."""

    @property
    def num_fish(self) -> int:
        """M, the number of controlled fish in each flow: its first bodies.

        With M > 1, ``head`` and ``heading`` of starts are ``[E, M, 2]`` and ``[E, M]``; actions,
        commands, observations, rewards and masks have the axis M after B. Termination and success
        remain per flow.
        """
        return 1

    @property
    def success(self) -> str | None:
        """Boolean entry of ``report`` that marks success; None: reaching the time limit does."""
        return None

    @property
    def max_frequency(self) -> float:
        """Highest tail-beat frequency, beats per T."""
        return 1.0

    @property
    def max_stream_speed_bl(self) -> float:
        """Fastest stream, L / T; 0 in still water."""
        return 0.0

    @cached_property
    def scales(self) -> Scales:
        """Lattice units of the task; the fastest beat or stream sets T, a multiple of 2^levels."""
        return Scales.from_budget(
            multiple=2**self.levels,
            body_length=self.body_length,
            reynolds=self.reynolds,
            max_wall_speed=self.max_wall_speed,
            gait=self.fish.gait,
            max_frequency=self.max_frequency,
            stream_speed_bl=self.max_stream_speed_bl,
        )

    @cached_property
    def fish(self) -> Fish:
        """Configuration of the fish."""
        return self.skin.fit(Fish(body_length=self.body_length))

    @property
    def bodies(self) -> tuple[BodyConfig, ...]:
        """All bodies of the flow; the fish come first."""
        return (self.fish,) * self.num_fish

    @property
    def n_substeps(self) -> int:
        """Steps per action, a multiple of 2^levels."""
        unit: int = 2**self.levels
        return unit * max(1, round(self.control_interval_T * self.scales.period / unit))

    @property
    def interval_T(self) -> float:
        """Duration of an action in periods T, rounded to whole steps."""
        return self.n_substeps / self.scales.period

    @cached_property
    def wall_margin(self) -> float:
        """Smallest distance of a marker from the edge, in nodes; with levels from sponges, too."""
        asked = self.wall_margin_bl * self.body_length
        return asked if self.levels == 1 else max(asked, self._least_margin)

    @property
    def _least_margin(self) -> float:
        """Margin from which no marker leaves the grid, or its patch, between two checks, nodes."""
        if self.levels > 1:
            return self.travel + self.flow_config().reach
        # markers that swim no faster than the tail beats keep from where a row counts as diverged
        return max(self.travel + 1.0, 0.5 * self.travel + self.skin.margin)

    @cached_property
    def travel(self) -> float:
        """Bound on the way of a marker between two checks for termination, in nodes."""
        samples, checks = find_extension(self, HasHistory).num_samples, self.checks_per_action
        stops = make_schedule(self.n_substeps, checks=checks, samples=samples, unit=2**self.levels)
        steps = [0, *(stop.step for stop in stops if stop.is_check)]
        return self.swimming_speed * max(after - before for before, after in pairwise(steps))

    @property
    def swimming_speed(self) -> float:
        """Bound on the speed of a marker in nodes per step, without commanded turns."""
        return 2.0 * self.scales.tail_speed  # if swimming at most doubles the speed of the tail

    @property
    def largest_turn(self) -> float:
        """Largest turn of an action, radians: it moves nose and tail at the largest speed."""
        # at its middle a turn is twice as fast as on average
        return MAX_IMPOSED_SPEED * self.n_substeps / self.body_length

    @property
    def largest_bend(self) -> float:
        """Largest bend that the method allows, body lengths; 0 unless the fish bends.

        From one side to the other it moves the tail at the largest speed that the method allows.
        """
        motion = self.fish.motion
        if not isinstance(motion, Bending):
            return 0.0
        return MAX_IMPOSED_SPEED * self.n_substeps / (2.0 * motion.response * self.body_length)

    @property
    def domain(self) -> tuple[int, int]:
        """Nodes of the flow along x and y; edges lie on nodes of the coarsest level."""
        sizes, unit = [size * self.body_length for size in self.domain_bl], 2 ** (self.levels - 1)
        more = self.levels > 1
        width, height = (unit * round(size / unit) + more for size in sizes)
        return width, height

    def list_patches(self) -> tuple[Patch, ...]:
        """Return patches; with none each body has one. Those that meet need one for both."""
        return ()

    def flow_config(self) -> FlowConfig:
        """Return the flow; the default is a closed tank of still water."""
        width, height = self.domain
        return FlowConfig(
            width=width,
            height=height,
            tau=self.scales.tau,
            bodies=self.bodies,
            skin=self.skin,
            levels=self.levels,
            patches=self.list_patches() if self.levels > 1 else (),
        )

    @abstractmethod
    def starts_from(self, uniform: Tensor) -> TensorDict:
        """Map random numbers ``[E, num_draws]`` in [0, 1), float64, to starts.

        Returns:
            TensorDict ``[E]`` with ``head`` ``[E, 2]`` (x, y) in nodes and ``heading`` ``[E]`` in
            radians, both float64, and any other parameters of an episode.
        """

    def sample_starts(self, num: int, generator: torch.Generator) -> TensorDict:
        """Draw ``num`` starts ``[E]``."""
        uniform = torch.rand(num, self.num_draws, generator=generator, dtype=torch.float64)
        return self.starts_from(uniform)

    def check_starts(self, starts: TensorDictBase) -> None:
        """Raise ValueError unless starts ``[E]`` have the right shapes and their fish fit in."""
        check_pattern(starts, self.starts_from(torch.zeros(1, self.num_draws, dtype=torch.float64)))
        check_fit(starts, self.fish, self.flow_config(), margin=self.wall_margin)

    def place_(self, solver: InPlaceSolver, rows: Tensor, starts: TensorDictBase) -> None:
        """Reset the flows of ``rows`` ``[B]`` bool and place their fish; others must not change.

        ``starts`` ``[B]`` are valid in ``rows``. The default is still water.
        """
        position, heading = place_fish(starts, self.fish)
        solver.reset_(rows, position, heading)

    def prepare_(self, solver: InPlaceSolver, starts: TensorDictBase) -> None:
        """Change the flow, such as its stream speed, before an action; by default nothing changes.

        ``starts`` ``[B]`` belong to the episodes; ``solver.body.age`` counts the steps since.
        """
        return

    @abstractmethod
    def command(self, action: Tensor, before: TensorDictBase) -> Command:
        """Map legal actions ``[B]`` (int64, in [0, num_actions)) to commands to the body.

        Continuous actions are ``[B, num_actions]``, float64, within ``action_bounds``. ``before``
        is the measurement ``[B]`` at the decision.
        """

    @abstractmethod
    def measure(self, solver: InPlaceSolver, starts: TensorDictBase) -> TensorDict:
        """Return a TensorDict ``[B]`` from which observation, reward and termination follow.

        Called several times within an action; a row keeps the first measurement that terminates its
        episode, or else the last one. ``solver.body.age`` counts the steps since reset; ``starts``
        ``[B]`` belong to the episodes. The environment keeps copies.
        """

    def observe(self, now: TensorDictBase) -> Tensor:
        """Return the observation ``[B, n_obs]``, float32."""
        return read_senses(self.senses, now)

    @abstractmethod
    def reward(self, before: TensorDictBase, now: TensorDictBase) -> dict[str, Tensor]:
        """Return the terms ``[B]`` of the reward for the interval between two measurements.

        The reward is their sum. Each term is reported by its name, ``reward/<term>``; a section
        ``Terms:`` of the docstring gives its formula for the reference page.
        """

    @abstractmethod
    def is_terminated(self, now: TensorDictBase) -> Tensor:
        """Return ``[B]`` bool: whether the episode ends in success or failure (not by time).

        Also called within actions, with the entries of ``measure`` only. Overriding it alone
        resets ``count_safe_steps`` to the default.
        """

    def count_safe_steps(self, now: TensorDictBase) -> Tensor:
        """Return a number of steps ``[B]`` in which an episode certainly does not terminate.

        The environment skips the checks for termination within these steps, on a CPU. ``now`` is as
        in ``is_terminated``. The default, 0, is always valid.
        """
        return torch.zeros(now.shape, device=now.device)

    def action_mask(self, now: TensorDictBase) -> Tensor:
        """Return ``[B, num_actions]`` bool: legal discrete actions, at least one per row."""
        shape = (*now.shape, *((self.num_fish,) if self.num_fish > 1 else ()), self.num_actions)
        return torch.ones(shape, dtype=torch.bool, device=now.device)

    def report(self, now: TensorDictBase) -> dict[str, Tensor]:
        """Return ``[B, ...]`` entries for the environment to write next to the observation.

        Booleans other than ``success`` are counted at the end of episodes: the metric
        ``<name>_rate`` is the share of episodes in which one was true.
        """
        return {}
