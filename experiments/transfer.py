"""Evaluate frozen policies in streams they were not trained in: ``python -m experiments.transfer``.

Runs the learned policies of run folders (``runs=[runs/a,runs/b]``, of ``task=karman_gait``) and
baselines from the same fixed starts in every flow. Writes tables, figures and ``transfer.json``;
histories are cached.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from experiments.gait import pictures, tables
from experiments.gait.diagnostics import combine_seeds, diagnose, measure_lean, trace_work
from experiments.gait.histories import Histories, split_flows, stack
from experiments.gait.trials import (
    PERIODS,
    GaitSettings,
    Trial,
    list_shedding,
    load_trial,
    make_trial,
    run_trial,
)
from experiments.program import program
from fishrl.bounds import bounded
from fishrl.envs import KarmanGait
from fishrl.training.description import make
from fishrl.training.progress import Progress
from fishrl.training.run_folder import write_json

#: Settings of the task that all policies must share.
SHARED = (
    "body_length",
    "reynolds",
    "domain_bl",
    "stream",
    "safe_area",
    "control_interval_T",
    "time_limit",
)


@dataclass(kw_only=True)
class TransferSettings(GaitSettings):
    """Settings of a transfer test.

    Args:
        runs: run folders of ``task=karman_gait``; runs of one kind are its seeds. The
            baselines use the task of the first run with macro-actions.
        episodes: in each flow.
        periods: duration of a trial in T.
        baselines: policies to compare with; see ``trials.make_trial``.
        samples_actions: sample the actions of learned policies, as in training.
        folder: for tables, figures and histories.
    """

    runs: tuple[str, ...] = ()
    episodes: int = bounded(100, least=1)
    periods: float = bounded(PERIODS, greater=0)
    baselines: tuple[str, ...] = ("pid", "pid+policy", "bang_bang", "shedding")
    samples_actions: bool = False
    folder: str = "runs/transfer"


def diagnose_flows(task: KarmanGait, flows: Sequence[Histories]) -> list[dict[str, float]]:
    """Return the diagnostics of one policy in each flow."""
    return [
        diagnose(
            histories,
            shedding_frequency=shedding,
            safe_area=task.safe_area,
            interval_T=task.interval_T,
            time_limit_T=task.time_limit * task.interval_T,
        )
        for histories, shedding in zip(flows, list_shedding(task), strict=True)
    ]


def check_trials(trials: Sequence[Trial]) -> None:
    """Check that there are policies, with different names and comparable tasks.

    Raises:
        ValueError: naming what is the same, or differs.
    """
    if not trials:
        raise ValueError("there is nothing to try: give runs=[...] or baselines=[...]")
    names = [trial.name for trial in trials]
    if len(set(names)) < len(names):
        raise ValueError(f"policies are called {sorted(names)}: rename run folders of equal names")
    for setting in SHARED:
        values = {trial.name: getattr(trial.task, setting) for trial in trials}
        if len(set(map(repr, values.values()))) > 1:
            raise ValueError(f"tasks differ in {setting}: {values}; try them separately")


def transfer(
    trials: Sequence[Trial],
    *,
    episodes: int,
    folder: Path,
    samples_actions: bool = False,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Run all trials, write tables and figures, and return the results.

    Those are ``arms``: diagnostics per arm and flow over its seeds; ``trials``: of each policy
    alone; ``work``: per arm and flow as it adds up in time.
    """
    check_trials(trials)
    task, best = trials[0].task, trials[0].arm
    speeds, interval_T = task.stream.speeds_bl, task.interval_T
    arms: dict[str, list[list[Histories]]] = {}
    alone: dict[str, list[dict[str, float]]] = {}
    kept: Any = {"folder": folder / "histories", "samples_actions": samples_actions}
    for trial in trials:
        histories = run_trial(trial, episodes=episodes, progress=progress, **kept)
        flows = split_flows(histories, len(speeds))
        arms.setdefault(trial.arm, []).append(flows)
        alone[trial.name] = diagnose_flows(trial.task, flows)
    combined: dict[str, list[dict[str, float]]] = {}
    for arm in arms:
        seeds = [alone[trial.name] for trial in trials if trial.arm == arm]
        combined[arm] = [combine_seeds(flow) for flow in zip(*seeds, strict=True)]
    work = {
        arm: [trace_work(stack(flow), interval_T=interval_T) for flow in zip(*seeds, strict=True)]
        for arm, seeds in arms.items()
    }
    results = {
        "speeds_bl": list(speeds),
        "arms": combined,
        "trials": alone,
        "episodes": episodes,
        "samples_actions": samples_actions,
        "work": work,
    }
    write_json(folder / "transfer.json", results)
    text = tables.write_results(combined, speeds)
    (folder / "transfer.md").write_text(text, encoding="utf-8")
    first = {arm: seeds[0] for arm, seeds in arms.items()}
    everything = [flows for seeds in arms.values() for flows in seeds]
    together = [stack(flow) for flow in zip(*everything, strict=True)]
    leans = [measure_lean(histories, interval_T=interval_T) for histories in together]
    pictures.write_survival(folder / "survival.png", arms, speeds=speeds)
    pictures.write_paths(folder / "paths.png", first, task=task)
    pictures.write_places(folder / "places.png", first, task=task)
    pictures.write_decisions(
        folder / "decisions.png", first[best], task=task, shedding=list_shedding(task)
    )
    pictures.write_lean(folder / "lean.png", leans, speeds=speeds)
    pictures.write_work(folder / "work.png", work[best], None, speeds=speeds)
    return results


@program(TransferSettings, groups={"task": "karman_gait", "preset": "gait_small"})
def main(settings: TransferSettings) -> None:
    """Load and evaluate the policies, and print the tables."""
    torch.set_num_threads(1)
    folder, periods = Path(settings.folder), settings.periods
    with Progress() as progress:
        trials = [load_trial(Path(run), periods=periods) for run in settings.runs]
        banked = [trial.task for trial in trials if trial.task.control.num_flows is not None]
        task = banked[0] if banked else make(settings.task, kind=KarmanGait)
        trials += [make_trial(name, task, periods=periods) for name in settings.baselines]
        transfer(
            trials,
            episodes=settings.episodes,
            folder=folder,
            samples_actions=settings.samples_actions,
            progress=progress,
        )
    print((folder / "transfer.md").read_text(encoding="utf-8"))
    print(f"written to {folder}")


if __name__ == "__main__":
    main()
