"""Try frozen policies where they were not trained: ``python -m experiments.robustness``.

Each condition changes settings of the task, the same for every policy: the disc, the streams, the
starts, the lateral line. ``conditions={wide:{stream:{diameter_bl:0.6}}}`` gives others. Policies
swim from the same starts in every stream; those of ``task=karman_varied`` in the streams of
``COMMON`` unless a condition says otherwise. Writes ``robustness.json``, ``robustness.md`` and
``robustness.png``; histories are cached, so the same command goes on after an interruption.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from omegaconf import OmegaConf

from experiments.figures.style import COLOURS, panels
from experiments.gait.diagnostics import diagnose
from experiments.gait.trials import (
    PERIODS,
    Histories,
    Trial,
    check_shared,
    list_shedding,
    load_trial,
    make_trial,
    run_trial,
)
from experiments.pages import write_table
from experiments.program import check_names, program
from experiments.statistics import compare_paired
from fishrl.bounds import Checked, bounded
from fishrl.envs import KarmanGait
from fishrl.envs.streams import Stream
from fishrl.modules import LateralLineClassifier
from fishrl.training.description import make, to_plain
from fishrl.training.progress import Progress
from fishrl.training.run_folder import write_json

#: Settings of the task that each condition changes.
CONDITIONS: dict[str, Any] = {
    "as trained": {},
    "disc of 0.3 L": {"stream": {"diameter_bl": 0.3}},
    "disc of 0.5 L": {"stream": {"diameter_bl": 0.5}},
    "disc of 0.6 L": {"stream": {"diameter_bl": 0.6}},
    "1.1, 1.3, 1.4 L/T": {"stream": {"speeds_bl": (1.1, 1.3, 1.4)}},
    "0.8, 1.25, 1.7 L/T": {"stream": {"speeds_bl": (0.8, 1.25, 1.7)}},
    "0.3 to 0.6 L aside": {"start_y_bl": (0.3, 0.6)},
    "2.5 to 3.5 L behind": {"start_x_bl": (2.5, 3.5)},
    "sensor noise 0.5 L/T": {"lateral_line": {"noise": 0.5}},
    "sensors delayed by T/4": {"lateral_line": {"delay": 2}},
}
#: Those of the policies that were trained behind one disc: where the others are tried, too.
COMMON: dict[str, Any] = {
    "stream": {"speeds_bl": (1.0, 1.25, 1.5), "diameter_bl": 0.4},
    "lateral_line": {"noise": 0.0},
}


@dataclass(kw_only=True)
class RobustnessSettings(Checked):
    """Settings of a trial under other conditions.

    Args:
        runs: policies of ``task=karman_gait``; those of one kind are the seeds of an arm.
        baselines: policies to compare with, as in ``experiments.transfer``.
        conditions: settings of the task by the name of the condition; without any ``CONDITIONS``.
        reference: arm that the others are compared with, start by start.
        episodes: episodes of each policy in each stream.
        periods: duration of an episode in T.
        folder: folder for the results.
    """

    runs: tuple[str, ...] = (
        *("zoo/gait_small", "zoo/gait_small_seed1", "zoo/gait_small_seed2"),
        *("zoo/gait_small_oracle", "zoo/gait_small_ablation"),
    )
    baselines: tuple[str, ...] = ("pid",)
    conditions: dict[str, Any] = field(default_factory=dict)
    reference: str = "pid"
    episodes: int = bounded(4, least=1)
    periods: float = bounded(PERIODS, greater=0)
    folder: str = "runs/robustness"


def vary(trial: Trial, changes: Mapping[str, Any]) -> Trial:
    """Return a trial with other settings of its task, such as ``{"start_x_bl": (2.5, 3.5)}``.

    Its classifier, if any, gives each stream the label that it knows in that place. A policy that
    was trained behind several discs gets the settings of ``COMMON`` first, and in each stream the
    row of frequencies of the most similar one in training.
    """
    recognition, has_several = trial.recognition, len(set(trial.task.stream.diameters_bl)) > 1
    common = COMMON if has_several else {}
    settings = OmegaConf.merge(*(to_plain(each) for each in (trial.task, common, changes)))
    if has_several:
        if isinstance(recognition, LateralLineClassifier):
            raise ValueError(
                f"runs: the classifier of {trial.name} knows streams behind several discs, and the "
                "conditions have others; give runs without a classifier"
            )
        _choose_rows(settings, trial.task)
    task = make(OmegaConf.to_container(settings), kind=KarmanGait)
    if isinstance(recognition, LateralLineClassifier):
        recognition = deepcopy(recognition)
        recognition.flows = task.flow_labels
    return replace(trial, task=task, recognition=recognition)


def _choose_rows(settings: Any, trained: KarmanGait) -> None:
    """Give each stream of the settings of a task the row of the most similar one in training."""
    stream = make(OmegaConf.to_container(settings.stream), kind=Stream)
    flows, known = (
        torch.tensor((each.speeds_bl, each.diameters_bl)).log().T
        for each in (stream, trained.stream)
    )
    nearest = torch.cdist(flows, known).argmin(1).tolist()
    settings.start_flows = list(range(len(nearest)))
    if trained.control.num_flows is not None:
        settings.control.bank.rows = [list(trained.control.rows[flow]) for flow in nearest]


def list_trials(
    tried: Sequence[Trial], baselines: Sequence[str], changes: Mapping[str, Any], *, periods: float
) -> list[Trial]:
    """Return the trials under a condition; baselines get the task of the first with macro-actions.

    ValueError if there is none, or if they cannot be compared.
    """
    trials = [vary(trial, changes) for trial in tried]
    banked = [trial.task for trial in trials if trial.task.control.num_flows is not None]
    if not banked:
        raise ValueError("runs: give one with macro-actions, whose task the baselines get")
    x, y = banked[0].start_x_bl, banked[0].start_y_bl
    for name in baselines:
        trial = make_trial(name, banked[0], periods=periods)
        trials.append(replace(trial, task=replace(trial.task, start_x_bl=x, start_y_bl=y)))
    check_shared(trials)
    return trials


def summarise(arms: Mapping[str, Sequence[Trial]], done: Mapping[str, list[Histories]]) -> Any:
    """Reduce a condition to numbers by arm.

    Survival by policy, stream and start; the number of diverged episodes; means of the rest.
    """
    summary = {}
    for arm, trials in arms.items():
        numbers = [
            diagnose(flow, trial.task, shedding_frequency=frequency)
            for trial in trials
            for flow, frequency in zip(done[trial.name], list_shedding(trial.task), strict=True)
        ]
        names = ("survivors", "work", "named_right")
        summary[arm] = {
            "survival_T": [[f.lengths_T.tolist() for f in done[t.name]] for t in trials],
            "diverged": int(sum(each["diverged"] for each in numbers)),
            **{name: float(np.mean([each[name] for each in numbers])) for name in names},
        }
    return summary


def tabulate(results: Mapping[str, Any], *, reference: str) -> str:
    """Return the tables, Markdown: survival, difference from the reference, work per T."""
    first = next(iter(results.values()))
    arms = list(first)
    others = [arm for arm in arms if arm != reference]

    def show_survival(condition: Mapping[str, Any], arm: str) -> str:
        of_arm = condition[arm]
        diverged = f", {of_arm['diverged']} diverged" if of_arm["diverged"] else ""
        return f"{np.mean(of_arm['survival_T']):.1f} ({of_arm['survivors']:.0%}{diverged})"

    def compare(condition: Mapping[str, Any], arm: str) -> str:
        # the streams are fixed, and a start recurs in each: only starts and seeds are drawn
        ours, theirs = (
            np.array(condition[name]["survival_T"]).mean(1) for name in (arm, reference)
        )
        return compare_paired(ours, theirs).show("+.1f")

    def write(heads: Sequence[str], show: Any) -> str:
        rows = [[name, *(show(each, arm) for arm in heads)] for name, each in results.items()]
        return write_table(("condition", *heads), rows)

    lasted = "Mean survival in T, and in brackets the share of episodes that lasted:"
    beyond = (
        f"Survival beyond that of *{reference}* from the same starts, T, and its 95 % interval:"
    )
    labelled = [arm for arm in arms if np.isfinite(first[arm]["named_right"])]
    tables = {
        lasted: write(arms, show_survival),
        beyond: write(others, compare),
        "Work per T, ρ L² (L/T)²:": write(arms, lambda each, arm: f"{each[arm]['work']:.3f}"),
        "Correct labels:": write(labelled, lambda each, arm: f"{each[arm]['named_right']:.1%}"),
    }
    parts = [f"{title}\n\n{table}" for title, table in tables.items()]
    return "\n".join((*parts, "![Survival under each condition](robustness.png)\n"))


def write_figure(path: Path, results: Mapping[str, Any]) -> None:
    """Draw the survival of every policy under each condition."""
    names, arms = list(results), list(next(iter(results.values())))
    with panels(path, size=(9.0, 1.2 + 0.45 * len(names))) as axes:
        chart = axes[0, 0]
        for number, arm in enumerate(arms):
            shift = 0.7 * ((number + 0.5) / len(arms) - 0.5)
            for row, name in enumerate(names):
                means = np.mean(results[name][arm]["survival_T"], axis=(1, 2))
                label, colour = arm if row == 0 else None, COLOURS[number % len(COLOURS)]
                rows = np.full(len(means), row + shift)
                chart.scatter(means, rows, color=colour, label=label, s=22, zorder=3)
        chart.set(yticks=range(len(names)), yticklabels=names, xlabel="survival [T]")
        chart.set_xlim(left=0.0)
        chart.invert_yaxis()
        chart.legend(loc="lower left", fontsize=8)


@program(RobustnessSettings)
def main(settings: RobustnessSettings) -> None:
    """Try all policies under every condition, and write tables and figure."""
    torch.set_num_threads(1)
    folder, periods = Path(settings.folder), settings.periods
    tried = [load_trial(Path(run), periods=periods) for run in settings.runs]
    check_names([*(trial.name for trial in tried), *settings.baselines])
    known = sorted({*(trial.arm for trial in tried), *settings.baselines})
    if settings.reference not in known:
        raise ValueError(f"reference = {settings.reference!r}: the arms are {known}")

    varied = {
        name: list_trials(tried, settings.baselines, changes, periods=periods)
        for name, changes in (settings.conditions or CONDITIONS).items()
    }
    results = {}
    with Progress() as progress:
        for name, trials in varied.items():
            done, arms = {}, dict[str, list[Trial]]()
            for trial in trials:
                done[trial.name] = run_trial(
                    trial, episodes=settings.episodes, folder=folder, progress=progress
                )
                arms.setdefault(trial.arm, []).append(trial)
            results[name] = summarise(arms, done)
            write_json(folder / "robustness.json", results)
    text = tabulate(results, reference=settings.reference)
    (folder / "robustness.md").write_text(text, encoding="utf-8")
    write_figure(folder / "robustness.png", results)
    print(text)
    print(f"written to {folder}")


if __name__ == "__main__":
    main()
