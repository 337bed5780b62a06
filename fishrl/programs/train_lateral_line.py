"""Train a lateral-line classifier: ``fishrl train-lateral-line seed=0``.

Collects labelled signals in every flow of a task, half under random actions and half under station
holding, and fits the classifier. Writes ``lateral_line.md`` with its accuracies and figures,
``lateral_line.json``, and ``machine.pt``, the classifier for ``recognition=``.
``preset=gait_small`` trains one for the task of that preset. Collected data are kept: the same
command continues after an interruption, and other fits reuse them.
"""

from __future__ import annotations

import logging
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from tensordict import TensorDict

from fishrl.envs import AbstractTask
from fishrl.programs.lateral_line.collection import collect
from fishrl.programs.lateral_line.fitting import Design, LateralLineSettings, fit
from fishrl.programs.lateral_line.report import describe, write_figures, write_page
from fishrl.programs.program import program
from fishrl.training.description import make, to_plain
from fishrl.training.progress import Progress
from fishrl.training.run_folder import RunFolder, write_json, write_yaml

logger = logging.getLogger(__name__)


def train_lateral_line(
    settings: LateralLineSettings, episodes: TensorDict, folder: Path, progress: Progress
) -> dict[str, Any]:
    """Fit the classifier to episodes as ``collect`` returns, and perhaps the paper's.

    Writes classifier, results and figures to the folder; returns what ``lateral_line.json`` has.
    """
    designs = {"classifier": Design.own(settings)}
    if settings.paper_epochs:
        designs["paper"] = Design.of_the_paper(settings)
    progress.start("fits", total=len(designs))
    fits = {}
    for name, design in designs.items():
        fits[name] = fit(settings, episodes, design)
        if name == "classifier":
            fits[name].classifier.save(folder / "machine.pt")
        progress.advance(1)
    findings = describe(episodes, fits)
    write_json(folder / "lateral_line.json", findings)
    (folder / "lateral_line.md").write_text(write_page(findings), encoding="utf-8")
    write_figures(fits, [flow["name"] for flow in findings["flows"]], folder)
    return findings


@program(LateralLineSettings, groups={"task": "karman_gait", "preset": None})
def main(settings: LateralLineSettings) -> None:
    """Collect, fit and write a run folder."""
    made = replace(settings, task=make(settings.task, kind=AbstractTask))
    place = made.place  # refuses a task without flows to tell apart
    name = made.name or f"lateral-line-{type(made.task).__name__.lower()}-seed{made.seed}"
    folder = RunFolder.create(parent=made.folder, name=name)
    write_yaml(folder.config, to_plain(asdict(settings)))
    logger.info("run folder: %s, data: %s", folder.path, place)
    with Progress() as progress:
        train_lateral_line(made, collect(made, progress), folder.path, progress)
    print((folder.path / "lateral_line.md").read_text(encoding="utf-8"))
    print(f"written to {folder.path}")
