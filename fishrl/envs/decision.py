"""A decision: from the actions of all rows to what follows from them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import reduce
from math import inf
from typing import Any

import torch
from tensordict import TensorDict
from torch import Tensor

from fishrl.envs.agents import TERM, group, name_entry, shape_fish
from fishrl.envs.checks import Problems, check_action, check_command, check_terms, scale_action
from fishrl.envs.extensions import HasHistory, find_extension
from fishrl.envs.schedule import make_schedule
from fishrl.envs.sense import read_senses
from fishrl.envs.task import AbstractTask
from fishrl.physics.fast.solver import InPlaceSolver

#: Called within an action with ``[B]`` bool, the rows that move and those that end at this moment.
OnFrame = Callable[[Tensor, Tensor], None]


class Decision:
    """What happens between the actions of all rows and the next observations.

    Nothing in it waits for a GPU, so that a graph can repeat it.

    Args:
        task: the task.
        solver: its flows.
        frames_per_action: calls of ``on_frame`` within an action.
        on_diverged: called with ``[B]`` bool, the rows that have diverged, where any have.

    Attributes:
        shape: of one number per fish.
        history: the task, or one that records nothing.
    """

    def __init__(
        self,
        task: AbstractTask,
        solver: InPlaceSolver,
        *,
        frames_per_action: int,
        on_diverged: Callable[[Tensor], None],
    ) -> None:
        self._task, self._solver, self._on_diverged = task, solver, on_diverged
        self.shape = shape_fish(task, solver.num_envs)
        self.history = find_extension(task, HasHistory)
        self._schedule = make_schedule(
            task.n_substeps,
            checks=task.checks_per_action,
            frames=frames_per_action,
            samples=self.history.num_samples,
            unit=2**task.levels,
        )
        self._measured: list[str] = []
        self._sensors: list[str] = []

    def measure(self, start: TensorDict) -> TensorDict:
        """Measure the current flows."""
        return self._task.measure(self._solver, start).to(self._solver.device)

    def begin(self, start: TensorDict) -> TensorDict:
        """Measure at the beginning of an episode, with the first sample repeated."""
        now, sensed, num = self.measure(start), self._sense(start), self.history.num_samples
        self._measured, self._sensors = list(now.keys()), list(sensed.keys())
        now.update(sensed.apply(lambda t: t.unsqueeze(1).expand(-1, num, *t.shape[1:])))
        return now.update(self.history.begin(now)).clone()

    def _sense(self, start: TensorDict) -> TensorDict:
        has_series = self.history.num_samples > 0
        sensed = self.history.sense(self._solver, start) if has_series else {}
        return TensorDict(sensed, start.batch_size, device=self._solver.device)

    def run(
        self, given: dict[str, Any], on_frame: OnFrame | None = None
    ) -> tuple[dict[str, TensorDict], Problems]:
        """Act in all rows.

        Args:
            given: ``action``, ``now`` (the measurement behind the last observation), ``inputs``
                (what a transform writes), ``start`` and ``is_resting``, ``[B]`` each.
            on_frame: see ``OnFrame``.

        Returns:
            ``now``, the next measurement, and ``written``, the output of the environment; and the
            problems that the host has yet to read.
        """
        task, now, start, problems = self._task, given["now"], given["start"], Problems()
        before, bounds = now.copy().update(given["inputs"]), task.action_bounds
        action = (
            check_action(given["action"], task.action_mask(now), problems)
            if bounds is None
            else scale_action(given["action"], bounds, problems)
        )
        command = task.command(action, before)
        check_command(task, command, self.shape, problems)
        task.prepare_(self._solver, start)
        steer = command.turn if command.bend is None else command.bend
        if steer is None:
            steer = torch.zeros(self.shape, device=self._solver.device)
        self._solver.command_(steer, task.n_substeps, command.frequency, command.amplitude)
        after, diverged = self._advance(before, start, given["is_resting"], on_frame)
        after.update(dict(command.kept)).update(self.history.remember(before, action, after))
        after = merge(~diverged, after, now)
        problems.note(~diverged, lambda: self._on_diverged(diverged))
        terminated = task.is_terminated(after) & ~diverged
        is_lost = diverged.view(-1, *(1,) * (len(self.shape) - 1))
        terms = check_terms(task, task.reward(before, after), self.shape)
        terms = {name: torch.where(is_lost, 0.0, term) for name, term in terms.items()}
        written = self.write(
            after,
            terms,
            diverged=diverged,
            done=terminated | diverged,
            terminated=terminated,
            truncated=diverged,
        )
        reward = reduce(torch.add, terms.values()).float()
        written.set(name_entry(task, "reward"), reward.unsqueeze(-1))
        return {"now": after, "written": written}, problems

    def write(self, now: TensorDict, terms: Mapping[str, Tensor], **flags: Tensor) -> TensorDict:
        """Return observation, mask, terms of the reward, reported entries and flags, as columns."""
        own = {"observation": self._task.observe(now)}
        if senses := self._task.critic_senses:
            own["critic_observation"] = read_senses(senses, now)
        own |= {TERM + name: term.float().unsqueeze(-1) for name, term in terms.items()}
        if self._task.action_bounds is None:
            own["action_mask"] = self._task.action_mask(now).clone()
        columns = {**self._task.report(now), **flags}
        written = {
            **group(own, self.shape),
            **{
                name: (value.unsqueeze(-1) if value.dim() == 1 else value).clone()
                for name, value in columns.items()
            },
        }
        return TensorDict(written, now.batch_size, device=self._solver.device)

    def _advance(
        self, before: TensorDict, start: TensorDict, is_resting: Tensor, on_frame: OnFrame | None
    ) -> tuple[TensorDict, Tensor]:
        """Run the flows for one action.

        Returns each row's measurement at its termination or at the end of the action, with its
        sensor series (undefined in diverged rows), and ``[B]`` bool, the diverged rows.
        """
        rows = _Rows(
            now=before.select(*self._measured),
            sensed=before.select(*self._sensors).apply(lambda series: series[:, -1]),
            has_ended=is_resting,
            diverged=torch.zeros_like(is_resting),
            is_ending=torch.zeros_like(is_resting),
        )
        reached = 0  # steps of the action; no row ends within the other number
        safe_until = self._count_safe_steps(before, is_resting)
        for stop in self._schedule:
            # not <=: NaN asks for a check
            is_check = stop.is_last or (stop.is_check and not stop.step <= safe_until)
            is_frame = on_frame is not None and stop.is_frame
            if not (is_check or is_frame or stop.is_sample):
                continue
            is_moving = ~rows.has_ended
            self._solver.advance_(stop.step - reached, is_moving)
            reached = stop.step
            if stop.is_sample:  # a row that has ended keeps what it sensed last
                rows.sensed = merge(rows.has_ended, rows.sensed, self._sense(start))
                rows.samples.append(rows.sensed)
            if is_check:
                safe_until = reached + self._check(rows, start, is_last=stop.is_last)
            if on_frame is not None and stop.is_frame:
                on_frame(is_moving, rows.is_ending & is_moving)
        now = rows.now.update(torch.stack(rows.samples, 1)) if rows.samples else rows.now
        return now, rows.diverged

    def _check(self, rows: "_Rows", start: TensorDict, *, is_last: bool) -> float:
        """Measure rows that end here; return a number of steps within which no other row ends."""
        measured, has_ended = self.measure(start), rows.has_ended
        rows.is_ending = self._task.is_terminated(measured) & ~has_ended
        is_new = ~has_ended if is_last else rows.is_ending
        # Checking whole fields is expensive: on a CPU only where rows have just ended; to ask a
        # GPU whether any have would be to wait for it.
        if is_new.is_cuda or is_new.any():
            rows.diverged = rows.diverged | is_new & self._solver.is_diverged()
            rows.now = merge(is_new, measured, rows.now)
            rows.has_ended = has_ended | is_new
            if not rows.samples:
                rows.sensed = merge(is_new, self._sense(start), rows.sensed)
        return 0.0 if is_last else self._count_safe_steps(measured, rows.has_ended)

    def _count_safe_steps(self, now: TensorDict, has_ended: Tensor) -> float:
        """Return how long no row ends after a measurement; 0 on a GPU, which would have to wait."""
        if has_ended.is_cuda:
            return 0.0
        steps = self._task.count_safe_steps(now).double()
        return float(steps.masked_fill(has_ended, inf).min())


@dataclass
class _Rows:
    """What has become of each row within an action."""

    now: TensorDict  #: measurement at its end; before, that at the decision
    sensed: TensorDict  #: latest sensor readings
    has_ended: Tensor  #: ``[B]`` bool
    diverged: Tensor  #: ``[B]`` bool
    is_ending: Tensor  #: ``[B]`` bool, terminated at the last check
    samples: list[TensorDict] = field(default_factory=list)  #: sensor series, oldest first


def merge(rows: Tensor, new: TensorDict, old: TensorDict) -> TensorDict:
    """Return copies of the entries of ``old``, with the values of ``new`` in ``rows`` ``[B]``."""
    if not rows.is_cuda and (rows == rows[0]).all():
        return (new.select(*old.keys()) if rows[0] else old).clone()
    return old.apply(
        lambda kept, fresh: torch.where(rows.view(-1, *(1,) * (kept.dim() - 1)), fresh, kept),
        new,
    )
