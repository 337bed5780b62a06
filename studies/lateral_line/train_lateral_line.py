"""Train a lateral-line classifier: ``python -m experiments.train_lateral_line seed=0``.

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

from experiments.lateral_line.collection import collect
from experiments.lateral_line.report import describe, write_figures, write_page
from experiments.lateral_line.study import LateralLineSettings, Study
from experiments.program import program
from fishrl.envs import AbstractTask
from fishrl.training.description import make, to_plain
from fishrl.training.progress import Progress
from fishrl.training.run_folder import RunFolder, write_json, write_yaml

logger = logging.getLogger(__name__)


def study_lateral_line(
    settings: LateralLineSettings, episodes: TensorDict, folder: Path, progress: Progress
) -> dict[str, Any]:
    """Fit the classifier and those to compare it with, to episodes as ``collect`` returns.

    Writes results and figures to the folder, and returns those of ``lateral_line.json``.
    """
    study = Study(settings, episodes)
    progress.start("fits", total=2)
    fit = study.fit_own()
    fit.classifier.save(folder / "machine.pt")
    progress.advance(1)
    paper = study.fit_paper()
    progress.advance(1)
    findings = describe(study, fit, paper, study.answer(progress))
    write_json(folder / "lateral_line.json", findings)
    (folder / "lateral_line.md").write_text(write_page(findings), encoding="utf-8")
    write_figures(findings, {"this classifier": fit, "as in the paper": paper}, folder)
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
        study_lateral_line(made, collect(made, progress), folder.path, progress)
    print((folder.path / "lateral_line.md").read_text(encoding="utf-8"))
    print(f"written to {folder.path}")


if __name__ == "__main__":
    main()
