"""Score a policy on a frozen task: ``fishrl score policy=runs/<name> task=station-v1``.

``policy`` is a run folder, a checkpoint, ``zoo/<name>``, a baseline of the task, an archive of
Stable-Baselines3, ``fish.zip``, or a function of a module on PYTHONPATH, ``module:function``. It
gets a TensorDict with ``observation_stack`` ``[B, n]``, ``is_init`` ``[B, 1]`` and, for discrete
actions, ``action_mask`` ``[B, num_actions]``, and returns it with ``action`` ``[B]``, or
``[B, num_actions]`` in [-1, 1]. The policy acts from each held-out start once; its row is shown in
the task's table.
"""

import os
import platform
import re
from contextlib import closing
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import tensordict
import torch
import torchrl
from pydantic import NonNegativeInt
from tensordict import TensorDictBase

from fishrl import __version__
from fishrl.benchmark import (
    Row,
    Version,
    compare,
    find_version,
    identify,
    list_rows,
    rank,
    show_table,
)
from fishrl.envs import AbstractTask, Flows
from fishrl.envs.episodes import Episodes, Policy, run_episodes
from fishrl.files import claim_file
from fishrl.programs.export_policy import read_revision
from fishrl.programs.program import program
from fishrl.programs.statistics import Interval, find_mean, find_share
from fishrl.programs.stored_task import read_result
from fishrl.training.baselines import find_baselines
from fishrl.training.callback import SILENT, Callback
from fishrl.training.checkpoint import Checkpoint
from fishrl.training.policies import is_learned, load_plan, prepare
from fishrl.training.progress import Progress
from fishrl.training.run_folder import write_json
from fishrl.wrappers.archives import load_archive

FUNCTION = re.compile(r"[\w.]+:\w+")
#: Entries that a policy from elsewhere reads, and no more.
SEEN = ("observation_stack", "action_mask", "is_init")


class Scored(NamedTuple):
    """A policy to score, and what is known of it."""

    kind: str
    act: str | Policy
    num_stacked: int | None = None  #: observations that it needs; None for those of the task
    decisions: int | None = None  #: of its training
    recognition: str | None = None  #: class of the source of flow labels
    differs: list[str] | None = None  #: settings of its training that differ


def find_policy(policy: str, version: Version, *, trust: bool) -> Scored:
    """Find what a word stands for.

    Raises:
        ValueError: for what cannot be found, and for an archive that is not trusted.
        ImportError: if the module of a function cannot be imported.
    """
    task = version.task
    if policy.endswith(".zip"):
        if not trust:
            raise ValueError(
                f"{policy}: loading an archive of Stable-Baselines3 unpickles it, which runs any "
                "code that its author put there: give trust=true if you trust it"
            )
        archive = load_archive(Path(policy).expanduser())
        num, rest = divmod(archive.num_inputs, task.n_obs)
        if rest or not num:
            raise ValueError(
                f"{policy}: observes {archive.num_inputs} numbers; in {version.name} a multiple of "
                f"{task.n_obs}"
            )
        own, wanted = (
            f"{number} {'choices' if is_discrete else 'numbers'}"
            for number, is_discrete in (
                (archive.num_actions, archive.is_discrete),
                (task.num_actions, task.action_bounds is None),
            )
        )
        if own != wanted:
            raise ValueError(f"{policy}: its action is one of {own}; {version.name} has {wanted}")
        return Scored("archive", _show_only(archive), num, archive.decisions)
    if FUNCTION.fullmatch(policy):
        module, _, name = policy.partition(":")
        try:
            found = getattr(import_module(module), name, None)
        except ImportError as error:
            raise ImportError(f"{policy}: {error} (is its folder on PYTHONPATH?)") from error
        if not callable(found) or isinstance(found, type):
            raise ValueError(f"{policy}: module {module} has no function {name!r}")
        return Scored("function", _show_only(found))
    if not is_learned(policy):
        if policy not in (known := find_baselines(task)):
            raise ValueError(
                f"policy = {policy}: no baseline of {version.name}, which has {', '.join(known)}; "
                "a run is given with its folder, runs/<name>, an archive with its .zip"
            )
        return Scored("baseline", policy, decisions=0)
    plan, result = load_plan(policy), read_result(policy)
    helps = {"initial_policy": plan.initial_policy, "teacher": result.get("teacher")}
    return Scored(
        "run",
        policy,
        plan.task.num_stacked,
        result.get("frames", Checkpoint.find(policy).frames),
        None if plan.recognition is None else type(plan.recognition).__name__,
        compare(plan.task, task) + [name for name, given in helps.items() if given is not None],
    )


def check_name(name: str, kind: str, task: AbstractTask) -> None:
    """Raise ValueError if a policy that is no baseline has the name of one."""
    if kind != "baseline" and name in find_baselines(task):
        raise ValueError(f"name = {name}: must differ from those of baselines")


def _show_only(act: Policy) -> Policy:
    """Return a policy that reads the entries of ``SEEN`` alone."""

    def decide(state: TensorDictBase) -> TensorDictBase:
        own = state.select(*SEEN, strict=False).clone()  # so that it changes none of ours
        decided = act(own)
        if not isinstance(decided, TensorDictBase) or "action" not in decided:
            raise ValueError(f"policy {act}: must return the TensorDict with its ``action``")
        return state.set("action", decided["action"])

    return decide


def score(
    policy: str,
    *,
    task: AbstractTask,
    split: str = "test",
    name: str | None = None,
    trust: bool = False,
    trained: NonNegativeInt | None = None,
    flows: Flows = Flows(),
    callback: Callback = SILENT,
) -> Row:
    """Run one episode from each start of a split, and return the row of the table.

    Args:
        policy: see ``fishrl score --help``.
        task: a frozen task, ``station-v1``; none of its settings may be changed but those in
            ``FREE``, such as ``num_stacked``, which a function may need.
        split: ``test``, or ``validation`` for choosing among policies.
        name: name of the policy in the table; by default ``policy``. Baselines keep theirs.
        trust: whether to load an archive of Stable-Baselines3, which runs code from it.
        trained: decisions of the training, where the policy does not tell.
        flows: flows that advance together, and how they are computed.
        callback: called as it advances.

    Raises:
        ValueError: for invalid arguments, and where the task is not as it was frozen.
    """
    version = identify(task)
    found = find_policy(policy, version, trust=trust)
    check_name(name or policy, found.kind, task)
    task = replace(task, num_stacked=found.num_stacked or task.num_stacked)
    held_out, starts = version.hold_out(split, task=task)
    flows = replace(flows, num_envs=min(flows.num_envs, len(starts)))
    commit = read_revision()
    begun = sum(os.times()[:4])  # with processes that have ended, as the flows' have below
    env, act = prepare(found.act, task=held_out, flows=flows, callback=callback)
    with closing(env):
        callback.on_phase("evaluation", total=len(starts))
        episodes = run_episodes(env, act, starts, on_episodes=callback.on_progress)
    value = measure(episodes, version.measure)
    return Row(
        policy=name or policy,
        kind=found.kind,
        task=version.name,
        split=split,
        settings=version.settings,
        starts=version.starts[split],
        measure=version.measure,
        value=value.value,
        low=value.low,
        high=value.high,
        metrics={n: x if x == x else None for n, x in episodes.metrics().items()},
        num_stacked=held_out.num_stacked,
        num_envs=flows.num_envs,
        recognition=found.recognition,
        differs=found.differs,
        trained_decisions=found.decisions if trained is None else trained,
        scored_decisions=int(episodes.lengths.sum()),
        cpu_seconds=round(sum(os.times()[:4]) - begun, 1),
        commit=commit,
        versions={
            "fishrl": __version__,
            "python": platform.python_version(),
            **{each.__name__: each.__version__ for each in (torch, torchrl, tensordict)},
        },
    )


def measure(episodes: Episodes, name: str) -> Interval:
    """Return the mean of a metric over episodes with its 95 % interval: Wilson's, or Student's."""
    if name == "success_rate":
        return find_share(int(episodes.succeeded.sum()), len(episodes.succeeded))
    values = {
        "mean_length_T": episodes.lengths * episodes.interval_T,
        "mean_return": episodes.returns,
    }
    return find_mean(values[name].tolist())


@program(score, without=("callback",), groups={"task": None})
def main(*, save: str | None = None, **given: Any) -> None:
    """Score, print the table with the new row, and store the row where ``save`` says.

    Args:
        save: JSON file for the row.
        **given: arguments of ``score``.
    """
    stored = list_rows(identify(given["task"]).name, given["split"])  # first: one may be damaged
    with claim_file(save) as path:
        with Progress() as progress:
            row = score(**given, callback=progress)
        if path is not None:
            write_json(path, row.model_dump())
    rows = [*(each for each in stored if each.policy != row.policy), row]
    print(f"{row.task}, {row.split}: {row.measure}, {row.metrics['episodes']} starts")
    print("\n".join(show_table(rows, mark=row)))
    if row.split != "test":
        print("no score: random actions and controller are scored on the test alone")
    elif rank(rows)[0][1] is None:
        print(
            f"no score: it needs the rows of random and {find_version(row.task).controller} in "
            "fishrl/benchmark/scores, and intervals that do not overlap"
        )
    if row.commit is None:
        print("commit unknown: fishrl/ is no git checkout, or differs from its last commit")
    print(f"{row.scored_decisions:,} decisions and {row.cpu_seconds:g} s of CPU for this scoring")
    if path is not None:
        print(f"written to {path}")
