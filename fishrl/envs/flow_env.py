"""The environment: B flows with a fish in each, and a task, as one TorchRL ``EnvBase``.

    action --task--> turn, frequency --solver--> n_substeps steps --task--> measurement
           --> observation, terms of the reward, terminated, action mask

This is the only ``EnvBase``; a task supplies everything specific. ``make_env`` adds TorchRL's
transforms.
"""

import logging
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import reduce
from inspect import Signature, signature
from math import inf
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Categorical, Composite
from torchrl.envs import EnvBase
from torchrl.envs.utils import MarlGroupMapType

from fishrl.envs.agents import TERM, group, name_entry, shape_fish
from fishrl.envs.checks import (
    check_action,
    check_answers,
    check_command,
    check_starts_of,
    check_terms,
    scale_action,
)
from fishrl.envs.draws import draw_uniform
from fishrl.envs.extensions import HasHistory, find_extension
from fishrl.envs.flows import Flows
from fishrl.envs.schedule import make_schedule
from fishrl.envs.sense import read_senses
from fishrl.envs.specs import make_specs
from fishrl.envs.task import AbstractTask
from fishrl.physics.fast.checks import check_device
from fishrl.physics.fast.solver import InPlaceSolver

logger = logging.getLogger(__name__)


class FlowEnv(EnvBase):
    """A batch of B flows with one fish each, or with M fish each if the task has several.

    With several fish, observations, actions, masks and rewards are ``[B, M, ...]`` under
    ``agents`` (``fishrl.envs.agents``), with ``group_map`` as in TorchRL's multi-agent
    environments. Episodes begin and end for all fish of a flow together.

    A row that terminates within an action keeps the measurement of that moment and does not advance
    to the end of the action (on a GPU its flow continues unread). A row has diverged if it is not
    finite or too fast for the method, if a body has left the grid, or if bodies overlap. It is then
    truncated with reward 0, with ``diverged`` set and with the observation of the last decision; it
    is counted and reset without affecting other rows.

    Args:
        task: the task.
        flows: number of flows B, and how they are computed; all tensors are on their device.
        seed: seed of the starts; each start depends on seed, row and episode only.
        starts: TensorDict ``[E]`` as returned by ``task.sample_starts``. Resets cycle through them,
            in order of rows within one reset. By default each start is drawn at random.
        frames_per_action: calls of ``on_frame`` within an action, at equal intervals: pictures, not
            the env frames of ``total_frames``.
        on_frame: called with this environment, to read ``solver`` and ``measure()``.

    Attributes:
        solver: the flows.
        start: ``[B]`` TensorDict, the start of each row's episode.
        now: ``[B]`` TensorDict, the measurement behind the last observation.
        num_diverged: number of rows that have diverged so far.
        is_resting: ``[B]`` bool, rows that are not advanced and whose output is undefined;
            ``run_episodes`` sets it for rows without a start.
        is_moving: ``[B]`` bool, for ``on_frame``: rows whose episode lasted up to this moment.
        is_ending: ``[B]`` bool, for ``on_frame``: rows whose episode terminates at this moment.
        group_map: TorchRL's map from group to agent names, with several fish.

    Raises:
        ValueError: for invalid arguments, or if a method of the task returns a wrong shape or type.
    """

    def __init__(
        self,
        *,
        task: AbstractTask,
        flows: Flows,
        seed: int = 0,
        starts: TensorDictBase | None = None,
        frames_per_action: int = 1,
        on_frame: Callable[["FlowEnv"], None] | None = None,
    ) -> None:
        check_device(flows.device)
        super().__init__(device=flows.device, batch_size=[flows.num_envs])
        if starts is None:
            check_starts_of(task)
        else:
            task.check_starts(starts)
            starts = starts.to(self.device)
        self.task, self.starts, self.on_frame = task, starts, on_frame
        self._shape = shape_fish(task, flows.num_envs)
        if task.num_fish > 1:
            names = [f"fish_{number}" for number in range(task.num_fish)]
            self.group_map = MarlGroupMapType.ALL_IN_ONE_GROUP.get_group_map(names)
        self._history = find_extension(task, HasHistory)  # the task, or one that records nothing
        self._schedule = make_schedule(
            task.n_substeps,
            checks=task.checks_per_action,
            frames=frames_per_action,
            samples=self._history.num_samples,
            unit=2**task.levels,
        )
        self._rows = torch.arange(flows.num_envs, device=self.device)
        self._seed, self._next_start = seed, 0
        self._episode = torch.zeros_like(self._rows)
        self._start_index = torch.full_like(self._rows, -1)
        self.num_diverged = 0
        self.is_resting = torch.zeros_like(self._rows, dtype=torch.bool)
        self.is_moving, self.is_ending = ~self.is_resting, self.is_resting
        self.solver = InPlaceSolver(
            config=task.flow_config(), frequency=1.0 / task.scales.period, **vars(flows)
        )
        self.start, _ = self._draw_starts(~self.is_resting)
        self._next_start = 0
        task.place_(self.solver, ~self.is_resting, self.start)
        self.now = self._begin()
        self._make_specs()  # reports an invalid task before the compilation
        self.solver.compile()

    #: Those of ``__init__``, which TorchRL's metaclass would hide.
    __signature__ = Signature([*signature(__init__).parameters.values()][1:])

    def measure(self) -> TensorDict:
        """Measure the current flows; also valid within an action."""
        return self.task.measure(self.solver, self.start).to(self.device)

    @contextmanager
    def set_starts(
        self, starts: TensorDictBase, *, on_frame: Callable[["FlowEnv"], None] | None = None
    ) -> Iterator[None]:
        """Use other starts, from the first one, in a ``with`` block; arguments as for the class.

        On exit the previous starts and ``on_frame`` are restored and no row rests; the flows remain
        as they are.
        """
        self.task.check_starts(starts)
        before = self.starts, self._next_start, self.on_frame
        self.starts, self._next_start, self.on_frame = starts.to(self.device), 0, on_frame
        try:
            yield
        finally:
            self.starts, self._next_start, self.on_frame = before
            self.is_resting = torch.zeros_like(self.is_resting)

    def _begin(self) -> TensorDict:
        """Measure at the beginning of an episode, with the first sample repeated."""
        now, sensed, num = self.measure(), self._sense(), self._history.num_samples
        self._measured, self._sensors = list(now.keys()), list(sensed.keys())
        now.update(sensed.apply(lambda t: t.unsqueeze(1).expand(-1, num, *t.shape[1:])))
        return now.update(self._history.begin(now))

    def _sense(self) -> TensorDict:
        has_series = self._history.num_samples > 0
        sensed = self._history.sense(self.solver, self.start) if has_series else {}
        return TensorDict(sensed, self.batch_size, device=self.device)

    def _make_specs(self) -> None:
        """Derive the specs from the task and a first measurement."""
        terms = check_answers(self.task, self.now)
        self._no_terms = {name: torch.zeros_like(term) for name, term in terms.items()}
        observation, action, reward = (
            spec.to(self.device) for spec in make_specs(self.task, self.now)
        )
        self.observation_spec_unbatched = observation
        self.full_action_spec_unbatched, self.full_reward_spec_unbatched = action, reward
        flags = ("done", "terminated", "truncated")
        self.done_spec_unbatched = Composite(
            {name: Categorical(2, shape=(1,), dtype=torch.bool) for name in flags}
        ).to(self.device)

    def _draw_starts(self, rows: Tensor) -> tuple[TensorDict, Tensor]:
        """Return starts ``[B]``, valid in ``rows``, and their indices."""
        if self.starts is None:
            uniform = draw_uniform(self._seed, self._rows, self._episode, self.task.num_draws)
            return self.task.starts_from(uniform), torch.full_like(self._rows, -1)
        index = (self._next_start + rows.long().cumsum(0) - 1) % self.starts.shape[0]
        self._next_start = (self._next_start + int(rows.sum())) % self.starts.shape[0]
        return self.starts[index], index

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDict:
        rows = torch.ones_like(self._rows, dtype=torch.bool)
        if tensordict is not None and "_reset" in tensordict:
            rows = tensordict["_reset"].reshape(self.batch_size)
        drawn, index = self._draw_starts(rows)
        self.start = _merge(rows, drawn, self.start)
        self._start_index = torch.where(rows, index, self._start_index)
        self._episode = self._episode + rows
        self.task.place_(self.solver, rows, self.start)
        self.now = _merge(rows, self._begin(), self.now)
        flags = ("diverged", "done", "terminated", "truncated")
        return self._write(self._no_terms, **dict.fromkeys(flags, torch.zeros_like(rows)))

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        action = self._read_action(tensordict[name_entry(self.task, "action")])
        before = self.now.copy().update(self._read_inputs(tensordict))
        command = self.task.command(action, before)
        check_command(self.task, command, self._shape)
        self.task.prepare_(self.solver, self.start)
        straight = torch.zeros(self._shape, device=self.device)
        steer = command.turn if command.bend is None else command.bend
        self.solver.command_(
            straight if steer is None else steer,
            self.task.n_substeps,
            command.frequency,
            command.amplitude,
        )
        now, diverged = self._advance(before)
        now.update(dict(command.kept)).update(self._history.remember(before, action, now))
        self.now = _merge(~diverged, now, self.now)
        if diverged.any():
            rows = diverged.nonzero().squeeze(-1).tolist()
            self.num_diverged += len(rows)
            meet = " (bodies overlap)" if (diverged & self.solver.overlaps).any() else ""
            logger.warning(
                "flows %s diverged%s and were truncated; %d so far", rows, meet, self.num_diverged
            )
        terminated = self.task.is_terminated(self.now) & ~diverged
        is_lost = diverged.view(-1, *(1,) * (len(self._shape) - 1))
        terms = check_terms(self.task, self.task.reward(before, self.now), self._shape)
        terms = {name: torch.where(is_lost, 0.0, term) for name, term in terms.items()}
        result = self._write(
            terms,
            diverged=diverged,
            done=terminated | diverged,
            terminated=terminated,
            truncated=diverged,
        )
        reward = reduce(torch.add, terms.values()).float()
        return result.set(name_entry(self.task, "reward"), reward.unsqueeze(-1))

    def _advance(self, before: TensorDict) -> tuple[TensorDict, Tensor]:
        """Run the flows for one action.

        Returns each row's measurement at its termination or at the end of the action, with its
        sensor series (undefined in diverged rows), and ``[B]`` bool, the diverged rows.
        """
        rows = _Rows(
            now=before.select(*self._measured),
            sensed=before.select(*self._sensors).apply(lambda series: series[:, -1]),
            has_ended=self.is_resting,
            diverged=torch.zeros_like(self.is_resting),
        )
        reached = 0  # steps of the action; no row ends within the other number
        safe_until = self._count_safe_steps(before, self.is_resting)
        for stop in self._schedule:
            # not <=: NaN asks for a check
            is_check = stop.is_last or (stop.is_check and not stop.step <= safe_until)
            on_frame = self.on_frame if stop.is_frame else None
            if not (is_check or on_frame or stop.is_sample):
                continue
            self.solver.advance_(stop.step - reached, ~rows.has_ended)
            reached = stop.step
            self.is_moving, self.is_ending = ~rows.has_ended, torch.zeros_like(rows.has_ended)
            if stop.is_sample:  # a row that has ended keeps what it sensed last
                rows.sensed = _merge(rows.has_ended, rows.sensed, self._sense())
                rows.samples.append(rows.sensed)
            if is_check:
                safe_until = reached + self._check(rows, is_last=stop.is_last)
            if on_frame:
                on_frame(self)
        now = rows.now.update(torch.stack(rows.samples, 1)) if rows.samples else rows.now
        return now, rows.diverged

    def _check(self, rows: "_Rows", *, is_last: bool) -> float:
        """Measure rows that end here; return a number of steps within which no other row ends."""
        measured, has_ended = self.measure(), rows.has_ended
        self.is_ending = self.task.is_terminated(measured) & ~has_ended
        is_new = ~has_ended if is_last else self.is_ending
        # Checking whole fields is expensive: on a CPU only where rows have just ended; to ask a
        # GPU whether any have would be to wait for it.
        if is_new.is_cuda or is_new.any():
            rows.diverged = rows.diverged | is_new & self.solver.is_diverged()
            rows.now = _merge(is_new, measured, rows.now)
            rows.has_ended = has_ended | is_new
            if not rows.samples:
                rows.sensed = _merge(is_new, self._sense(), rows.sensed)
        return 0.0 if is_last else self._count_safe_steps(measured, rows.has_ended)

    def _count_safe_steps(self, now: TensorDict, has_ended: Tensor) -> float:
        """Return how long no row ends after a measurement; 0 on a GPU, which would have to wait."""
        if has_ended.is_cuda:
            return 0.0
        return float(self.task.count_safe_steps(now).masked_fill(has_ended, inf).min())

    def _read_action(self, action: Tensor) -> Tensor:
        """Return legal actions in the form that the task expects."""
        bounds = self.task.action_bounds
        if bounds is not None:
            return scale_action(action, bounds)
        return check_action(action, self.task.action_mask(self.now))

    def _read_inputs(self, tensordict: TensorDictBase) -> dict[str, Tensor]:
        """Return the entries that the task reads in addition to the action."""
        missing = [name for name in self._history.inputs if name not in tensordict]
        if missing:
            raise ValueError(
                f"{type(self.task).__name__} reads {missing}, which this step's tensordict lacks: "
                "append the transform that writes it (make_env(transforms=[...])), or configure "
                "the task not to read it"
            )
        return {name: tensordict[name].reshape(self.batch_size) for name in self._history.inputs}

    def _write(self, terms: Mapping[str, Tensor], **flags: Tensor) -> TensorDict:
        """Return observation, mask, terms of the reward, reported entries and flags, as columns."""
        own = {"observation": self.task.observe(self.now)}
        if senses := self.task.critic_senses:
            own["critic_observation"] = read_senses(senses, self.now)
        own |= {TERM + name: term.float().unsqueeze(-1) for name, term in terms.items()}
        if self.task.action_bounds is None:
            own["action_mask"] = self.task.action_mask(self.now).clone()
        columns = {**self.task.report(self.now), **flags}
        written = {
            **group(own, self._shape),
            "start_index": self._start_index.clone(),
            **{
                name: (value.unsqueeze(-1) if value.dim() == 1 else value).clone()
                for name, value in columns.items()
            },
        }
        return TensorDict(written, self.batch_size, device=self.device)

    @property
    def seed(self) -> int:
        """Seed of the starts."""
        return self._seed

    def _set_seed(self, seed: int | None) -> None:
        """Restart the sequence of starts from ``seed`` (0 if None) at the next reset."""
        self._seed = 0 if seed is None else seed
        self._episode, self._next_start = torch.zeros_like(self._episode), 0

    def get_extra_state(self) -> dict[str, Any]:
        """Return the complete state of flows and episodes, for ``state_dict``."""
        return {
            "solver": self.solver.state_dict(),
            "start": self.start.clone().to_dict(),
            "now": self.now.clone().to_dict(),
            "start_index": self._start_index.clone(),
            "episode": self._episode.clone(),
            "num_diverged": torch.tensor(self.num_diverged),
            "seed": torch.tensor(self._seed),
            "next_start": torch.tensor(self._next_start),
        }

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Restore a state, bit for bit."""
        self.solver.load_state_dict(state["solver"])
        for name in ("start", "now"):
            restored = TensorDict(state[name], self.batch_size, device=self.device)
            setattr(self, name, restored.clone())
        for name in ("start_index", "episode"):
            setattr(self, f"_{name}", state[name].to(self.device).clone())
        self._seed, self._next_start = int(state["seed"]), int(state["next_start"])
        self.num_diverged = int(state["num_diverged"])

    def to(self, device: torch.device | str) -> "FlowEnv":
        """Return the environment; ValueError for another kind of device: flows cannot move."""
        if torch.device(device).type != self.device.type:
            raise ValueError(f"flows on {self.device} cannot move to {device}: make another env")
        return self

    def close(self, *, raise_if_closed: bool = True) -> None:
        """End the solver's processes, if any."""
        super().close(raise_if_closed=raise_if_closed)
        self.solver.close()


@dataclass
class _Rows:
    """What has become of each row within an action."""

    now: TensorDict  #: measurement at its end; before, that at the decision
    sensed: TensorDict  #: latest sensor readings
    has_ended: Tensor  #: ``[B]`` bool
    diverged: Tensor  #: ``[B]`` bool
    samples: list[TensorDict] = field(default_factory=list)  #: sensor series, oldest first


def _merge(rows: Tensor, new: TensorDict, old: TensorDict) -> TensorDict:
    """Return the entries of ``old``, with the values of ``new`` in ``rows`` ``[B]``."""
    if not rows.is_cuda and (rows == rows[0]).all():  # one of them, itself
        return new.select(*old.keys()) if rows[0] else old
    return old.apply(
        lambda kept, fresh: torch.where(rows.view(-1, *(1,) * (kept.dim() - 1)), fresh, kept),
        new,
    )
