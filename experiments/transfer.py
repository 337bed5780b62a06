"""Evaluate frozen policies in streams they were not trained in: ``python -m experiments.transfer``.

Runs the learned policies of run folders (``runs=[runs/a,runs/b]``, of ``task=karman_gait``) and
baselines from the same fixed starts in every flow. Writes tables, figures and ``transfer.json``;
histories are cached.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from pydantic import NonNegativeInt, PositiveFloat, PositiveInt

from experiments.gait import figures, trials
from experiments.gait.diagnostics import combine_seeds, diagnose, trace_work
from experiments.gait.free_stream import hold_in_free_stream
from experiments.gait.tables import write_free_stream, write_results
from fishrl.envs import Flows, KarmanGait, Recognition
from fishrl.files import claim, write_whole
from fishrl.programs.program import program
from fishrl.settings import Settings
from fishrl.training.callback import SILENT, Callback
from fishrl.training.progress import Progress
from fishrl.training.run_folder import write_json


class TransferSettings(Settings):
    """Settings of a transfer test.

    Args:
        task: task of the baselines, unless a run brings its own.
        preset: name of a preset; only its task is used.
        runs: run folders of ``task=karman_gait``; runs of one kind are its seeds. The
            baselines use the task of the first run with macro-actions.
        episodes: episodes in each flow.
        periods: duration of a trial in T.
        baselines: policies to compare with; see ``trials.make_trial``.
        recognition: source of the labels of all runs instead of their own.
        free_episodes: episodes in each stream without the half disc, held by a PID controller,
            whose work is compared with that of the first policy; 0 for none.
        folder: folder for tables, figures and histories.
        flows: how flows are computed; all episodes of a policy run together.
    """

    task: KarmanGait
    preset: str | None = None
    runs: tuple[str, ...] = ()
    episodes: PositiveInt = 100
    periods: PositiveFloat = trials.PERIODS
    baselines: tuple[str, ...] = ("pid", "pid+policy", "bang_bang", "shedding")
    recognition: Recognition | None = None
    free_episodes: NonNegativeInt = 0
    folder: str = "runs/transfer"
    flows: Flows = Flows()


def transfer(
    tried: Sequence[trials.Trial], settings: TransferSettings, progress: Callback = SILENT
) -> dict[str, Any]:
    """Run all trials, write tables and figures, and return the results.

    Those are ``shedding``: its frequencies, per T; ``arms``: diagnostics per arm and flow over its
    seeds; ``trials``: of each policy alone; ``free_stream``: as ``hold_in_free_stream`` returns, or
    None.
    """
    trials.check_comparable(tried)
    folder, task, best = Path(settings.folder), tried[0].task, tried[0].arm
    speeds, shedding = task.stream.speeds_bl, trials.list_shedding(task)
    arms: dict[str, list[list[trials.Histories]]] = {}
    alone: dict[str, list[dict[str, float]]] = {}
    for trial in tried:
        histories = trials.run_trial(
            trial,
            episodes=settings.episodes,
            folder=folder,
            flows=settings.flows,
            progress=progress,
        )
        arms.setdefault(trial.arm, []).append(histories)
        alone[trial.name] = [
            diagnose(flow, trial.task, shedding_frequency=frequency)
            for flow, frequency in zip(histories, trials.list_shedding(trial.task), strict=True)
        ]
    combined = {}
    for arm in arms:
        seeds = [alone[trial.name] for trial in tried if trial.arm == arm]
        combined[arm] = [combine_seeds(flow) for flow in zip(*seeds, strict=True)]
    free = None
    if settings.free_episodes:
        free = hold_in_free_stream(
            task,
            episodes=settings.free_episodes,
            periods=settings.periods,
            folder=folder,
            flows=settings.flows,
            progress=progress,
        )
    results = {
        "speeds_bl": list(speeds),
        "shedding": shedding,
        "arms": combined,
        "trials": alone,
        "episodes": settings.episodes,
        "free_stream": free,
    }
    write_json(folder / "transfer.json", results)
    text = write_results(combined, speeds)
    if free is not None:
        text += f"\n{write_free_stream(free, combined[best], speeds)}"
    write_whole(folder / "transfer.md", text)
    first = {arm: seeds[0] for arm, seeds in arms.items()}
    figures.write_survival(folder / "survival.png", arms, speeds=speeds)
    figures.write_paths(folder / "paths.png", first, task=task)
    figures.write_decisions(folder / "decisions.png", first[best], task=task, shedding=shedding)
    together = [trials.concatenate(flow) for flow in zip(*arms[best], strict=True)]
    work = [trace_work(flow, interval_T=task.interval_T) for flow in together]
    in_free = None if free is None else free["work"]
    figures.write_work(folder / "work.png", work, in_free, speeds=speeds)
    return results


@program(groups={"task": "karman_gait", "preset": "gait_small"})
def main(settings: TransferSettings) -> None:
    """Load and evaluate the policies, and print the tables."""
    torch.set_num_threads(1)
    periods = settings.periods
    with Progress() as progress:
        given: Any = {"periods": periods, "recognition": settings.recognition}
        tried = [trials.load_trial(Path(run), **given) for run in settings.runs]
        banked = [trial.task for trial in tried if trial.task.control.num_flows is not None]
        if banked and settings.task != main.read(()).task:
            raise ValueError("task, preset: the runs bring their own; leave them out")
        task = banked[0] if banked else settings.task
        tried += [trials.make_trial(name, task, periods=periods) for name in settings.baselines]
        with claim(Path(settings.folder) / "transfer.md"):
            transfer(tried, settings, progress)
    print((Path(settings.folder) / "transfer.md").read_text(encoding="utf-8"))
    print(f"written to {settings.folder}")


if __name__ == "__main__":
    main()
