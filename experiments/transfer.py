"""Who holds station in streams it never trained in: ``python -m experiments.transfer runs/...``.

Takes the learned fish of run folders (``task=karman_gait``), lets each swim from the same fixed
starts in every flow, frozen, and puts hand-written fish beside them. Writes tables, figures and
``transfer.json``; what was swum before is not swum again.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch

from experiments.command_line import plain_errors, set_up_logging
from experiments.config import build, load_config
from experiments.gait import pictures, tables
from experiments.gait.diagnostics import (
    combine_seeds,
    diagnose,
    measure_lean,
    pick,
    stack,
    trace_work,
)
from experiments.gait.histories import Histories
from experiments.gait.trials import PERIODS, Trial, hand_written, load_trial, run_trial
from fishrl.envs import KarmanGait
from fishrl.training.progress import Progress

HAND_WRITTEN = ("pid", "pid+policy", "bang_bang", "shedding")


def split_flows(histories: Histories, num_flows: int) -> list[Histories]:
    """Return the episodes of each flow."""
    return [pick(histories, histories.flow == flow) for flow in range(num_flows)]


def judge(task: KarmanGait, flows: Sequence[Histories]) -> list[dict[str, float]]:
    """Return the numbers of one fish in each flow."""
    return [
        diagnose(
            histories,
            shedding_frequency=shed,
            safe_area=task.safe_area,
            interval_T=task.interval_T,
            time_limit_T=task.time_limit * task.interval_T,
        )
        for histories, shed in zip(flows, list_shedding(task), strict=True)
    ]


def list_shedding(task: KarmanGait) -> list[float]:
    """Return the shedding frequency of each flow, per T; NaN in free streams."""
    if task.wakes is None:
        return [float("nan")] * len(task.stream.speeds_bl)
    frequencies: list[float] = (task.wakes.shedding_frequencies * task.scales.period).tolist()
    return frequencies


def check_trials(trials: Sequence[Trial]) -> None:
    """Refuse fish that cannot be told apart, or compared.

    Raises:
        ValueError: for two of one name, or of tasks with other flows or another arena.
    """
    names = [trial.name for trial in trials]
    twice = {name for name in names if names.count(name) > 1}
    if twice:
        raise ValueError(f"several fish are called {sorted(twice)}: rename the run folders")
    first = trials[0].task
    for trial in trials:
        for name in (
            "body_length",
            "reynolds",
            "domain_bl",
            "stream",
            "safe_area",
            "control_interval_T",
            "time_limit",
        ):
            known, other = getattr(first, name), getattr(trial.task, name)
            if known != other:
                raise ValueError(
                    f"{trial.name}: its task has {name} = {other}, that of {trials[0].name} "
                    f"{known}; try them apart"
                )


def transfer(
    trials: Sequence[Trial],
    *,
    episodes: int,
    folder: Path,
    samples_actions: bool = False,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Run every trial and write tables and figures.

    Args:
        trials: the fish; those of one arm are its seeds.
        episodes: in each flow.
        folder: for everything.
        samples_actions: let learned fish draw their actions; otherwise they take the likeliest.
        progress: the bar.

    Returns:
        ``arms``: per arm and flow the numbers over its seeds; ``trials``: of each fish alone;
        ``work``: per arm and flow as it adds up in time.
    """
    check_trials(trials)
    folder.mkdir(parents=True, exist_ok=True)
    task = trials[0].task
    speeds = task.stream.speeds_bl
    recorded: dict[str, list[Histories]] = {}
    alone: dict[str, list[dict[str, float]]] = {}
    arms: dict[str, list[str]] = {}
    for trial in trials:
        histories = run_trial(
            trial,
            episodes=episodes,
            folder=folder / "histories",
            samples_actions=samples_actions,
            progress=progress,
        )
        recorded[trial.name] = split_flows(histories, len(speeds))
        alone[trial.name] = judge(trial.task, recorded[trial.name])
        arms.setdefault(trial.arm, []).append(trial.name)
    combined = {
        arm: [combine_seeds([alone[name][flow] for name in names]) for flow in range(len(speeds))]
        for arm, names in arms.items()
    }
    results: dict[str, Any] = {"speeds_bl": list(speeds), "arms": combined, "trials": alone}
    results |= {"episodes": episodes, "samples_actions": samples_actions}
    results["work"] = {
        arm: [
            trace_work(stack([recorded[name][flow] for name in names]), interval_T=task.interval_T)
            for flow in range(len(speeds))
        ]
        for arm, names in arms.items()
    }
    (folder / "transfer.json").write_text(json.dumps(results, indent=2) + "\n", encoding="utf-8")
    text = tables.write_table(combined, speeds) + "\n" + tables.write_ends(combined, speeds)
    (folder / "transfer.md").write_text(text, encoding="utf-8")
    lengths = {
        arm: [
            [recorded[name][flow].lengths_T.tolist() for name in names]
            for flow in range(len(speeds))
        ]
        for arm, names in arms.items()
    }
    first = {arm: recorded[names[0]] for arm, names in arms.items()}
    pictures.write_survival(folder / "survival.png", lengths, speeds=speeds)
    pictures.write_paths(folder / "paths.png", first, task=task)
    pictures.write_places(folder / "places.png", first, task=task)
    best = next(iter(first.values()))
    pictures.write_decisions(
        folder / "decisions.png", best, task=task, shedding=list_shedding(task)
    )
    leans = [
        measure_lean(
            stack([flows[flow] for flows in recorded.values()]), interval_T=task.interval_T
        )
        for flow in range(len(speeds))
    ]
    pictures.write_lean(folder / "lean.png", leans, speeds=speeds)
    pictures.write_work(folder / "work.png", results["work"][trials[0].arm], None, speeds=speeds)
    return results


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description="Frozen fish in every flow, side by side.")
    parser.add_argument("runs", type=Path, nargs="*", help="run folders of task=karman_gait")
    parser.add_argument("--episodes", type=int, default=100, help="in each flow")
    parser.add_argument("--periods", type=float, default=PERIODS, help="T that each is tried")
    parser.add_argument(
        "--hand-written", nargs="*", default=list(HAND_WRITTEN), help="fish to put beside them"
    )
    parser.add_argument(
        "--preset", default="gait_small", help="of the hand-written fish, if there is no run"
    )
    parser.add_argument(
        "--set", nargs="*", default=[], help="settings of that preset, such as task.reynolds=400"
    )
    parser.add_argument(
        "--sample", action="store_true", help="draw actions as in training, not the likeliest"
    )
    parser.add_argument("--folder", type=Path, default=Path("runs/transfer"))
    arguments = parser.parse_args()
    set_up_logging()
    with plain_errors(), Progress() as progress:
        if arguments.episodes < 1:
            raise ValueError(f"episodes = {arguments.episodes}: must be at least 1")
        if arguments.periods <= 0.0:
            raise ValueError(f"periods = {arguments.periods}: must be positive")
        periods = arguments.periods
        trials = [load_trial(run, periods=periods) for run in arguments.runs]
        banked = [trial.task for trial in trials if trial.task.control.num_flows is not None]
        task = banked[0] if banked else load_task(arguments.preset, arguments.set)
        trials += [hand_written(name, task, periods=periods) for name in arguments.hand_written]
        transfer(
            trials,
            episodes=arguments.episodes,
            folder=arguments.folder,
            samples_actions=arguments.sample,
            progress=progress,
        )
    print((arguments.folder / "transfer.md").read_text(encoding="utf-8"))
    print(f"written to {arguments.folder}")


def load_task(preset: str, overrides: Sequence[str] = ()) -> KarmanGait:
    """Return the task of a preset."""
    arguments = ["task=karman_gait", f"preset={preset}", *overrides]
    config: Mapping[str, Any] = load_config("train", arguments).task
    task: KarmanGait = build(config)
    return task


if __name__ == "__main__":
    torch.set_num_threads(1)
    main()
