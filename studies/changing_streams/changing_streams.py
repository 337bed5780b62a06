"""Evaluate policies of steady streams in changing ones: ``python -m experiments.changing_streams``.

Each policy with macro-actions is tried with flow labels from several sources, from the same starts
and in the same changes of the stream; then the ablation without lateral line and macro-actions, and
a hand-crafted controller that is given the true label. ``task.stream.changes.interval_T=10`` is
another interval between changes. Writes ``changing.json``, ``changing.md`` and ``changing.png``.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from statistics import fmean, median
from typing import Any, NamedTuple

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase, Transform

from experiments.figures.style import COLOURS, panels
from experiments.gait.trials import PERIODS, Trial, check_shared, load_trial, make_trial
from experiments.pages import write_table
from experiments.program import TaskSettings, check_names, program
from experiments.statistics import Statistic, show
from fishrl.bounds import bounded
from fishrl.envs import (
    KarmanGait,
    PredictedFlowLabel,
    TrueFlowLabel,
    make_env,
    make_recognition,
)
from fishrl.envs.episodes import run_episodes
from fishrl.envs.transforms import HISTORY, LATERAL_LINE, FlowLabelTransform
from fishrl.modules import LateralLineClassifier
from fishrl.training.description import make
from fishrl.training.evaluation import fixed_starts
from fishrl.training.progress import Progress
from fishrl.training.run_folder import write_json

#: Time after the beginning of a change within which it should be recognised, T.
PROMPT_T = 2.0


@dataclass(frozen=True, kw_only=True)
class ChangingSettings(TaskSettings):
    """Settings of a trial in changing streams.

    Args:
        runs: policies with macro-actions and a lateral-line classifier, one per seed.
        ablations: policies without either.
        recognition: file of another classifier instead of those of ``runs``.
        episodes: episodes of each policy and source of labels.
        periods: duration of an episode in T.
        switching_rate: switching rate of the filter, per decision; by default the mean rate of
            the changes.
        folder: folder for the results.
    """

    runs: tuple[str, ...] = ("zoo/gait_small", "zoo/gait_small_seed1", "zoo/gait_small_seed2")
    ablations: tuple[str, ...] = ("zoo/gait_small_ablation",)
    recognition: str | None = None
    episodes: int = bounded(8, least=1)
    periods: float = bounded(PERIODS, greater=0)
    switching_rate: float | None = bounded(None, least=0, largest=1)
    folder: str = "runs/changing"


class ConstantFlowLabel(FlowLabelTransform):
    """Write the same label always: macro-actions that know nothing of the flow."""

    def __init__(self, *, num_flows: int, label: int) -> None:
        super().__init__(num_flows=num_flows, in_key="flow_index")
        self.label = label

    def compute_probabilities(self, now: TensorDictBase, *, begins: Tensor | None) -> Tensor:
        """Return 1 for the label."""
        flow = torch.full(now.batch_size, self.label, device=now.device)
        return torch.nn.functional.one_hot(flow, self.num_flows).float()


class FlowLabelByRow(FlowLabelTransform):
    """Write labels from several sources, each for as many rows, one after the other."""

    def __init__(self, sources: Sequence[FlowLabelTransform], *, is_observed: bool) -> None:
        num = sources[0].num_flows
        super().__init__(num_flows=num, in_key="flow_index", is_observed=is_observed)
        self.sources = sources

    def set_container(self, container: Transform | EnvBase) -> None:
        """Also begin without evidence in each row."""
        super().set_container(container)
        if (env := self.container) is not None:
            for source in self.sources:
                if isinstance(source, PredictedFlowLabel):
                    source.evidence = torch.zeros(*env.batch_size, self.num_flows)

    def compute_probabilities(self, now: TensorDictBase, *, begins: Tensor | None) -> Tensor:
        """Return what the source of each row says."""
        said = [source.compute_probabilities(now, begins=begins) for source in self.sources]
        return torch.cat([one.chunk(len(said))[k] for k, one in enumerate(said)])

    def choose_label(self, probabilities: Tensor) -> Tensor:
        """Return the label that the source of each row makes of it."""
        parts = zip(self.sources, probabilities.chunk(len(self.sources)), strict=True)
        return torch.cat([source.choose_label(part) for source, part in parts])


class Record(NamedTuple):
    """E episodes of N decisions; NaN after the end of an episode, and where there is no label."""

    time_T: Tensor  #: [N] of the decisions
    speed: Tensor  #: [E, N] of the stream, L / T
    true: Tensor  #: [E, N] the true label
    named: Tensor  #: [E, N] the label that the policy is given
    x: Tensor  #: [E, N] nose behind the disc, L
    lengths_T: Tensor  #: [E] of the episodes
    diverged: Tensor  #: [E] bool

    def pick(self, rows: slice) -> Record:
        """Return some of the episodes."""
        return Record(self.time_T, *(value[rows] for value in self[1:]))


def list_sources(
    machine: LateralLineClassifier, num_flows: int, *, rate: float
) -> dict[str, FlowLabelTransform]:
    """Return what labels the flows, by name; ``rate`` is the filter's, per decision."""
    key = LATERAL_LINE if machine.num_intervals == 1 else HISTORY
    predict = partial(PredictedFlowLabel, machine=machine, in_key=key)
    return {
        "true label": TrueFlowLabel(num_flows=num_flows),
        "always the middle flow": ConstantFlowLabel(num_flows=num_flows, label=num_flows // 2),
        "filter": predict(memory=1.0, switching_rate=rate),
        "filter, memory 0.7": predict(memory=0.7, switching_rate=rate),
        "memory 0.7": predict(memory=0.7),
        "memory 1, no forgetting": predict(memory=1.0),
        "current signal only": predict(memory=0.0),
        "filter, rows interpolated": predict(memory=1.0, switching_rate=rate, interpolates=True),
    }


def try_sources(
    trial: Trial, task: KarmanGait, *, rate: float, episodes: int, progress: Progress
) -> dict[str, Record]:
    """Run the episodes of a policy with each source of labels, all side by side."""
    machine = trial.recognition
    if not isinstance(machine, LateralLineClassifier):
        raise ValueError(f"{trial.name}: its run has no classifier; give others in runs=")
    num, is_observed = len(task.flow_labels), task.num_label_inputs > 0
    sources = list_sources(machine, num, rate=rate)
    *stacks, _ = make_recognition(machine)
    transforms = [*stacks, FlowLabelByRow(list(sources.values()), is_observed=is_observed)]
    how: Any = {"episodes": episodes, "num_copies": len(sources), "progress": progress}
    done = record(task, trial, transforms, **how)
    rows = [slice(k * episodes, (k + 1) * episodes) for k in range(len(sources))]
    return {name: done.pick(mine) for name, mine in zip(sources, rows, strict=True)}


def record(
    task: KarmanGait,
    trial: Trial,
    transforms: Sequence[Transform] = (),
    *,
    episodes: int,
    num_copies: int = 1,
    progress: Progress,
) -> Record:
    """Run episodes from fixed starts, the same ones for every policy and in every copy."""
    starts = torch.cat([fixed_starts(task, episodes, seed=0)] * num_copies)
    env = make_env(task=task, num_envs=len(starts), transforms=transforms)
    rows: list[Tensor] = []
    progress.start(trial.name, total=task.time_limit)

    def keep(start_of: Tensor, step: TensorDictBase) -> None:
        after, nothing = step["next"], torch.full(step.shape, torch.nan)
        entries = [after[name].reshape(-1) for name in ("stream_speed", "flow_index")]
        entries += [after.get("flow_class", nothing).reshape(-1), env.base_env.now["place"][:, 0]]
        rows.append(torch.stack([entry.double() for entry in entries], -1))
        progress.advance(1)

    outcome = run_episodes(env, trial.make_policy(), starts, on_step=keep)
    env.close()
    series = torch.stack(rows, 1)
    is_over = torch.arange(series.shape[1]) >= outcome.lengths[:, None]
    series[is_over] = torch.nan
    time_T = task.interval_T * torch.arange(1, series.shape[1] + 1)
    speed, true, named, x = series.unbind(-1)
    lengths_T = outcome.lengths * task.interval_T
    found = {"speed": speed, "true": true, "named": named, "x": x, "lengths_T": lengths_T}
    return Record(time_T, **found, diverged=outcome.diverged)


def find_delays(done: Record, task: KarmanGait) -> list[float]:
    """Return, in T, how long after its beginning each change was recognised; infinite if never.

    Counted are changes to another label that the fish outlives by ``PROMPT_T``, until the next one
    begins.
    """
    assert task.stream.changes is not None
    starts = fixed_starts(task, len(done.true), seed=0)
    speeds = starts["stream_speeds"]
    known = torch.tensor(task.stream.speeds_bl, dtype=torch.float64)
    before = torch.cat((known[starts["flow_index"]][:, None], speeds), 1)
    sizes = torch.tensor(task.stream.diameters_bl)
    is_other = sizes != sizes[starts["flow_index"]][:, None, None]  # behind another disc
    labels = (before[..., None] - known).abs().masked_fill(is_other, math.inf).argmin(-1)
    times = [*task.stream.changes.list_times(speeds.shape[1]), math.inf]
    delays = []
    for episode in range(len(speeds)):
        for k in range(speeds.shape[1]):
            is_same = labels[episode, k + 1] == labels[episode, k]
            if is_same or done.lengths_T[episode] < times[k] + PROMPT_T:
                continue
            is_after = (done.time_T > times[k]) & (done.time_T <= times[k + 1])
            is_right = is_after & (done.named[episode].round() == labels[episode, k + 1])
            first = done.time_T[is_right]
            delays.append(float(first[0]) - times[k] if len(first) else math.inf)
    return delays


def summarise(records: Sequence[Record], task: KarmanGait) -> dict[str, Any]:
    """Reduce the records of an arm, one per policy, to numbers."""
    lengths = torch.cat([each.lengths_T for each in records])
    delays = [delay for each in records for delay in find_delays(each, task)]
    named = torch.cat([each.named.flatten() for each in records])
    true = torch.cat([each.true.flatten() for each in records])
    is_known = ~named.isnan()
    return {
        "survival_T": lengths.tolist(),
        "survival_by_policy_T": [float(each.lengths_T.mean()) for each in records],
        "accuracy": float((named.round() == true)[is_known].double().mean()),
        "changes": len(delays),
        "recognised": fmean(d <= PROMPT_T for d in delays) if delays else math.nan,
        "median_delay_T": median(delays) if delays else math.nan,
        "delays_T": delays,
        "diverged": int(sum(each.diverged.sum() for each in records)),
    }


def tabulate(results: dict[str, dict[str, Any]]) -> str:
    """Return the table of all arms, Markdown.

    Intervals of survival are over policies; those of a single one over its episodes.
    """
    heads = (
        *("labels from", "policies", "survival, T", "label right", "changes"),
        *(f"recognised within {PROMPT_T:g} T", "median delay, T", "diverged"),
    )
    rows = []
    for name, arm in results.items():
        shown = ["–"] * 4
        if not math.isnan(arm["accuracy"]):
            delay = arm["median_delay_T"]
            shown = [f"{arm['accuracy']:.1%}", arm["changes"], show(arm["recognised"], ".1%")]
            shown.append("never" if delay == math.inf else show(delay, ".2f"))
        policies = arm["survival_by_policy_T"]
        survival = Statistic.of(policies if len(policies) > 1 else arm["survival_T"]).show(".1f")
        rows.append([name, len(policies), survival, *shown, arm["diverged"]])
    return write_table(heads, rows)


def write_figure(
    path: Path, results: dict[str, dict[str, Any]], first: dict[str, Record], names: Sequence[str]
) -> None:
    """Draw an episode of the first policy under each source of labels, and the delays of all."""
    with panels(path, size=(9.0, 5.6), rows=2, columns=2) as axes:
        stream, labels, places, delays = axes.flat
        drawn = [name for name, each in first.items() if not each.named.isnan().all()]
        longest = max(first.values(), key=lambda each: float(each.lengths_T[0]))
        stream.plot(longest.time_T, longest.speed[0], color="black")
        stream.set(ylabel="stream [L/T]", xlabel="time [T]")
        for number, name in enumerate(drawn):
            each, colour = first[name], COLOURS[number % len(COLOURS)]
            shift = 0.06 * (number - 0.5 * len(drawn))
            style: Any = {"color": colour, "label": name, "linewidth": 1.0}
            labels.step(each.time_T, each.named[0] + shift, where="post", **style)
            places.plot(each.time_T, each.x[0], **style)
            ordered = sorted(results[name]["delays_T"])
            shares = [(i + 1) / len(ordered) for i in range(len(ordered))]
            delays.step([0.0, *ordered], [0.0, *shares], where="post", **style)
        labels.set(ylabel="label", xlabel="time [T]", yticks=range(len(names)))
        labels.set_yticklabels(names)
        places.set(ylabel="nose behind the disc [L]", xlabel="time [T]")
        delays.axvline(PROMPT_T, color="grey", linewidth=0.7)
        delays.set(xlabel="time since the change began [T]", ylabel="recognised", xlim=(0.0, 14.0))
        delays.legend(fontsize=7, loc="center right")


@program(ChangingSettings, groups={"task": "karman_changing", "preset": None})
def main(settings: ChangingSettings) -> None:
    """Try all policies, and write table and figure."""
    torch.set_num_threads(1)
    changes = make(settings.task, kind=KarmanGait).stream.changes
    usual = deepcopy(main.read(()).task)
    usual["stream"]["changes"] = settings.task["stream"]["changes"]
    if settings.task != usual:
        raise ValueError("task: the runs bring their own; give task.stream.changes alone")
    if changes is None:
        raise ValueError("task.stream.changes is None: take task=karman_changing")

    def change(trial: Trial) -> KarmanGait:
        return replace(trial.task, stream=replace(trial.task.stream, changes=changes))

    periods, arms = settings.periods, defaultdict[str, list[Record]](list)
    learned = [
        load_trial(Path(run), periods=periods, recognition=settings.recognition)
        for run in settings.runs
    ]
    others = [load_trial(Path(run), periods=periods) for run in settings.ablations]
    check_names([trial.name for trial in learned])
    check_names([trial.name for trial in (*learned, *others)])
    check_shared([replace(trial, task=change(trial)) for trial in (*learned, *others)])
    others.append(make_trial("pid", learned[0].task, periods=periods))
    with Progress() as progress:
        how: Any = {"episodes": settings.episodes, "progress": progress}
        for trial in learned:
            task, rate = change(trial), settings.switching_rate
            if rate is None:
                rate = min(1.0, task.interval_T / changes.typical_interval_T)
            for name, done in try_sources(trial, task, rate=rate, **how).items():
                arms[name].append(done)
        for trial in others:
            arms[trial.arm].append(record(change(trial), trial, **how))
    task = change(learned[0])
    results = {name: summarise(records, task) for name, records in arms.items()}
    folder = Path(settings.folder)
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / "changing.json", results)
    table = tabulate(results)
    (folder / "changing.md").write_text(table, encoding="utf-8")
    names = [f"{speed:g} L/T" for speed in task.stream.speeds_bl]
    first = {name: records[0] for name, records in arms.items()}
    write_figure(folder / "changing.png", results, first, names)
    print(table)
    print(f"written to {folder}")


if __name__ == "__main__":
    main()
