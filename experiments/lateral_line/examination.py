"""One study of a lateral line from data to files: the machine, its rivals, figures and a page."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

from tensordict import TensorDict

from experiments.lateral_line.collection import Collection
from experiments.lateral_line.findings import (
    describe_fit,
    find_confirmation,
    find_leaks,
    find_memory,
    find_noise,
    find_window,
)
from experiments.lateral_line.pictures import write_confusion, write_curves, write_limits
from experiments.lateral_line.report import write_page
from experiments.lateral_line.study import Diet, Fit, Study, diets
from experiments.settings import LateralLineConfig
from fishrl.envs.lateral_line import LOCAL, LateralLine
from fishrl.modules.lateral_line import BOOKKEEPING
from fishrl.objectives import FitSettings
from fishrl.training.progress import Progress

#: Control intervals that a machine reads unless told otherwise.
NUM_INTERVALS = 8


def examine(
    config: LateralLineConfig, *, task: Any, episodes: TensorDict, folder: Path, progress: Progress
) -> dict[str, Any]:
    """Fit the machine and those it is compared with, and write everything there is to see.

    Args:
        config: the settings.
        task: whose flows are told apart.
        episodes: ``[E, D]`` as ``collect`` returns.
        folder: that takes the files.
        progress: the bar.
    """
    splits, levels, lengths = config.num_splits, config.noises, config.windows
    study = Study(
        episodes=episodes,
        flows=task.flow_labels,
        layout=Collection(task=task).task.lateral_line_layout,
        hidden=config.hidden,
        settings=FitSettings(
            learning_rate=config.learning_rate,
            batch_size=config.batch_size,
            num_epochs=config.num_epochs,
            patience=config.patience,
            weight_decay=config.weight_decay,
        ),
        seed=config.seed,
    )
    sample_T = study.layout["interval_T"]
    window = config.window or NUM_INTERVALS * task.lateral_line.num_samples
    # Counted beforehand for the bar; see the functions below.
    num_fits = 2 + splits * (len(lengths) + 2 + len(levels) + 3 * len(diets(window)) + 2)
    progress.start("fits", total=num_fits)

    def on_fit() -> None:
        progress.advance(1)

    machine = fit_machine(study, task.lateral_line, config)
    machine.machine.save(folder / "machine.pt")
    on_fit()
    paper = fit_as_in_the_paper(study, config)
    on_fit()
    diet = Diet(features=LOCAL, num_samples=window)
    is_decision = episodes["is_decision"]
    findings: dict[str, Any] = {
        "flows": task.flow_labels,
        "sensors": dict(task.lateral_line_layout),
        "features": machine.machine.features,
        "window_T": machine.machine.num_samples * sample_T,
        "chance": 1.0 / len(task.flow_labels),
        "num_splits": splits,
        "data": {
            "samples": int(is_decision.sum()),
            "episodes": len(episodes),
            "decisions_per_episode": float(is_decision.sum(1).double().mean()),
            "sample_T": sample_T,
        },
        "machine": describe_fit(machine),
        "paper": describe_fit(paper),
        "memory": find_memory(
            study, diet, memories=config.memories, num_splits=splits, on_fit=on_fit
        ),
        "windows": find_window(study, lengths=lengths, num_splits=splits, on_fit=on_fit),
        "noise": find_noise(study, diet, levels=levels, num_splits=splits, on_fit=on_fit),
        "leaks": find_leaks(study, window=window, num_splits=splits, on_fit=on_fit),
        "confirmation": find_confirmation(study, diet, num_splits=splits, on_fit=on_fit),
    }
    (folder / "lateral_line.json").write_text(json.dumps(findings, indent=2) + "\n")
    (folder / "lateral_line.md").write_text(write_page(findings), encoding="utf-8")
    draw(findings, {"this machine": machine, "as in the paper": paper}, folder=folder)
    return findings | {"folder": folder}


def fit_machine(study: Study, line: LateralLine, config: LateralLineConfig) -> Fit:
    """Fit the machine that the task will use, on what its own lateral line would have told."""
    diet = Diet(
        features=tuple(name for name in line.features if name not in BOOKKEEPING),
        num_samples=config.window or NUM_INTERVALS * line.num_samples,
        is_averaged=line.is_averaged,
        told=line.features,
    )
    return study.fit(diet, noise=config.noise)


def fit_as_in_the_paper(study: Study, config: LateralLineConfig) -> Fit:
    """Fit on single instants of the mean over the neuromasts, with time and place, for long."""
    diet = next(iter(diets(int(study.layout["num_samples"])).values()))
    settings = replace(FitSettings.of_the_paper(), num_epochs=config.paper_epochs)
    return study.fit(diet, settings=settings, max_samples=config.num_samples, is_mirrored=False)


def draw(findings: dict[str, Any], fits: dict[str, Fit], *, folder: Path) -> None:
    """Write the figures."""
    chance = findings["chance"]
    curves = {name: fit.curves for name, fit in fits.items()}
    write_curves(curves, folder / "curves.png", chance=chance)
    write_confusion(
        {name: fit.held_out.confusion.tolist() for name, fit in fits.items()},
        folder / "confusion.png",
        names=[flow["name"] for flow in findings["flows"]],
    )
    write_limits(
        folder / "limits.png",
        windows=findings["windows"],
        noise=findings["noise"],
        memory=findings["memory"]["by_decision"],
        sample_T=findings["data"]["sample_T"],
        chance=chance,
    )
