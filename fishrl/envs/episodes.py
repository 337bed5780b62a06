"""The episode runner: one episode from each of a set of starts, in all flows of an env at once."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import torch
from pydantic import PositiveInt
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase, TransformedEnv
from torchrl.envs.utils import ExplorationType, set_exploration_type

from fishrl.envs.agents import TERM, EachFish, average_fish
from fishrl.envs.flow_env import FlowEnv
from fishrl.envs.task import AbstractTask
from fishrl.envs.traces import Traces
from fishrl.settings import checked

Policy = Callable[[TensorDictBase], TensorDictBase]
#: Named values ``[B, ...]`` to record, or nothing.
Values = Mapping[str, Tensor] | None


@dataclass(frozen=True, kw_only=True)
class Episodes:
    """Outcome of E episodes, in the order of their starts; on the CPU."""

    returns: Tensor  #: ``[E]`` sum of rewards, averaged over several fish
    lengths: Tensor  #: ``[E]`` number of decisions, int64
    succeeded: Tensor  #: ``[E]`` bool, whether the task was accomplished, see ``has_succeeded``
    terminated: Tensor  #: ``[E]`` bool, whether the task itself ended the episode
    #: ``[E]`` bool, whether the flow diverged; such an episode counts as no success
    diverged: Tensor
    interval_T: float  #: duration of a decision in T
    #: ``[E]`` sums of the terms of the reward by ``reward/<term>``, averaged over several fish
    terms: dict[str, Tensor] = field(default_factory=dict)
    #: ``[E]`` bool each, flags at the end by name, see ``name_counted``
    counted: dict[str, Tensor] = field(default_factory=dict)
    #: what the callbacks of ``run_episodes`` returned
    traces: Traces = field(default_factory=lambda: Traces(0))

    def find_typical(self) -> int:
        """Return the start whose episode ended as most did, after about their median length."""
        is_usual = self.succeeded == (self.succeeded.double().mean() >= 0.5)
        off = (self.lengths - self.lengths[is_usual].median()).abs()
        return int(off.masked_fill(~is_usual, int(self.lengths.max()) + 1).argmin())

    def metrics(self) -> dict[str, float]:
        """Reduce to numbers; the time to success is NaN where there was none."""
        lengths_T = (self.lengths * self.interval_T).double()
        times = lengths_T[self.succeeded]
        return {
            "success_rate": float(self.succeeded.double().mean()),
            "mean_return": float(self.returns.double().mean()),
            "mean_length_T": float(lengths_T.mean()),
            "mean_time_to_success_T": float(times.mean()) if len(times) else math.nan,
            "episodes": len(self.succeeded),
            "diverged": int(self.diverged.sum()),
            **{name: float(total.double().mean()) for name, total in self.terms.items()},
            **{f"{name}_rate": float(flag.double().mean()) for name, flag in self.counted.items()},
        }


@checked
def run_episodes(
    env: TransformedEnv,
    policy: Policy,
    starts: TensorDictBase,
    *,
    max_decisions: PositiveInt | None = None,
    on_begin: Callable[[Tensor, TensorDictBase], Values] | None = None,
    on_step: Callable[[Tensor, TensorDictBase], Values] | None = None,
    on_frame: Callable[[Tensor, FlowEnv], Values] | None = None,
    on_episodes: Callable[[int], None] | None = None,
) -> Episodes:
    """Run one episode from each of E starts; return their outcome and what callbacks recorded.

    Starts go to the B rows in order, each to the first row that is free. A row without a start
    rests: its flow is not advanced, and its output is undefined.

    The first argument of ``on_begin``, ``on_step`` and ``on_frame`` is ``start_of`` ``[B]`` int64,
    the index of the start that each row runs, or -1 in rows that the call does not concern. They
    may return named values ``[B, ...]``; they are appended to the ``traces`` of the
    episodes concerned.

    Args:
        env: environment of a ``FlowEnv``; its current episodes are abandoned.
        policy: writes ``action`` ``[B]``. In flows with several fish it is applied to each of
            them; see ``EachFish``.
        starts: ``[E]``, as ``task.sample_starts`` returns.
        max_decisions: decisions after which all episodes are stopped; those still running count
            as neither succeeded nor terminated. By default the time limit of the env ends them.
        on_begin: called with the rows that have just begun, and the state ``[B]`` after their
            reset.
        on_step: called after each decision with the rows that ran, and the step ``[B]`` as the env
            returns it; flows and ``FlowEnv.now`` are still in their state at its end.
        on_frame: called ``frames_per_action`` times within a decision, at equal intervals, with the
            rows whose episode lasted up to this moment, and the ``FlowEnv``; without it,
            ``FlowEnv.on_frame`` stays.
        on_episodes: called after each decision with the number of episodes that it ended, and at
            last with the number of those that were stopped.
    """
    base, num_starts, num_rows = env.base_env, starts.shape[0], env.batch_size[0]
    act = policy if base.task.num_fish == 1 else EachFish(policy)
    tally, traces = _Tally(env, num_starts), Traces(num_starts)
    start_of = torch.arange(num_rows, device=base.device)
    start_of = start_of.masked_fill(start_of >= num_starts, -1)
    num_begun, num_decisions = num_rows, 0

    def call(callback: Callable[[Tensor, Any], Values] | None, rows: Tensor, what: Any) -> None:
        if callback is not None and (values := callback(rows, what)):
            traces.add(rows, values)

    def show_frame(flows: FlowEnv) -> None:
        call(on_frame, start_of.masked_fill(~flows.is_moving, -1), flows)

    with (
        base.set_starts(starts, on_frame=show_frame if on_frame else base.on_frame),
        torch.no_grad(),
        set_exploration_type(ExplorationType.DETERMINISTIC),
    ):
        state, has_begun = env.reset(), start_of >= 0
        while (is_open := start_of >= 0).any() and num_decisions != max_decisions:
            if has_begun.any():
                call(on_begin, start_of.masked_fill(~has_begun, -1), state)
            num_decisions += 1
            base.is_resting = ~is_open
            step = env.step(act(state))
            call(on_step, start_of, step)
            tally.add(step["next"], start_of)
            # A reset hands the next starts to the rows that are done, in order of rows.
            is_done = step["next", "done"].squeeze(-1)
            if on_episodes is not None:
                on_episodes(int((is_done & is_open).sum()))
            start_of = torch.where(is_done, num_begun + is_done.cumsum(0) - 1, start_of)
            start_of = start_of.masked_fill(start_of >= num_starts, -1)
            num_begun += int(is_done.sum())
            state, has_begun = env.maybe_reset(env.step_mdp(step)), is_done & (start_of >= 0)
    if on_episodes is not None:
        on_episodes(int((start_of >= 0).sum()))
    return tally.finish(traces)


class _Tally:
    """Sums of rewards, lengths and flags of E episodes, updated after each decision."""

    def __init__(self, env: TransformedEnv, num: int) -> None:
        self.task, self.counted = env.base_env.task, name_counted(env)
        flags = ("succeeded", "terminated", "diverged", *self.counted)
        self.sums = {name: torch.zeros(num).to(env.device) for name in ("reward", *name_terms(env))}
        self.lengths = torch.zeros(num, dtype=torch.int64, device=env.device)
        self.flags = {name: torch.zeros_like(self.lengths, dtype=torch.bool) for name in flags}

    def add(self, after: TensorDictBase, start_of: Tensor) -> None:
        """Add a decision that led to the states ``after`` ``[B]``."""
        is_open = start_of >= 0
        index = start_of[is_open]
        for name, total in self.sums.items():
            total[index] += average_fish(after, name)[is_open, 0]
        self.lengths[index] += 1
        ended = {name: after[name] for name in ("terminated", "diverged")}
        ended["succeeded"] = has_succeeded(after, self.task.success) & after["done"]
        for name, (entry, column) in self.counted.items():
            ended[name] = after[entry][:, column, None]
        for name, flag in self.flags.items():
            flag[index] = ended[name][is_open, 0]

    def finish(self, traces: Traces) -> Episodes:
        """Return the outcome."""
        flags = {name: flag.cpu() for name, flag in self.flags.items()}
        sums = {name: total.cpu() for name, total in self.sums.items()}
        return Episodes(
            returns=sums.pop("reward"),
            terms=sums,
            lengths=self.lengths.cpu(),
            interval_T=self.task.interval_T,
            counted={name: flags.pop(name) for name in self.counted},
            traces=traces,
            **flags,
        )


def count_decisions(task: AbstractTask, periods: float | None) -> int:
    """Return how many decisions last some periods T, rounded up; None is a whole episode."""
    return task.time_limit if periods is None else math.ceil(periods / task.interval_T - 1e-9)


def name_terms(env: EnvBase) -> list[str]:
    """Return the entries with the terms of the reward, ``reward/<term>``, per fish as it is."""
    keys = env.observation_spec.keys(True, True)
    leaves = (key if isinstance(key, str) else key[-1] for key in keys)
    return [name for name in leaves if name.startswith(TERM)]


def name_counted(env: EnvBase) -> dict[str, tuple[str, int]]:
    """Return entry and column of each flag that is counted at the end of episodes, by its name.

    They are the booleans of ``report`` other than ``success``; the columns of one with several are
    ``<name>_0`` and so on.
    """
    base = env.base_env
    known = {"diverged", "action_mask", base.task.success}
    return {
        f"{name}_{column}" if spec.shape[-1] > 1 else name: (name, column)
        for name, spec in base.observation_spec.items()
        if spec.dtype == torch.bool and name not in known
        for column in range(spec.shape[-1])
    }


def has_succeeded(after: TensorDictBase, success: str | None) -> Tensor:
    """Return whether episodes that ended in the states ``after`` accomplished their task.

    ``success`` is the task's ``success``: an entry, or None if reaching the time limit is success.
    """
    if success is None:
        flag: Tensor = after["truncated"] & ~after["terminated"]
    else:
        flag = after[success]
    is_fine: Tensor = ~after["diverged"]
    return flag & is_fine
