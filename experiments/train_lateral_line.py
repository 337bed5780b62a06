"""Train a lateral-line classifier: ``python -m experiments.train_lateral_line seed=0``.

Collects labelled signals in every flow of a task, half under random actions and half under station
holding, and fits the classifier. Writes ``lateral_line.md`` with its accuracies and figures,
``lateral_line.json``, and ``machine.pt``, the classifier for ``recognition=``.
``preset=gait_small`` trains one for the task of that preset. Collected data are kept: the same
command continues after an interruption, and other fits reuse them.
"""

from __future__ import annotations

import logging
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from omegaconf import MISSING
from tensordict import TensorDict

from experiments.lateral_line.collection import Collection, collect
from experiments.lateral_line.questions import answer, list_training_data
from experiments.lateral_line.report import describe, write_figures, write_page
from experiments.lateral_line.study import Study, TrainingData
from experiments.program import program
from fishrl.bounds import bounded
from fishrl.envs import AbstractTask
from fishrl.modules.lateral_line import BOOKKEEPING
from fishrl.objectives import FitSettings
from fishrl.training.description import make, to_plain
from fishrl.training.progress import Progress
from fishrl.training.run_folder import RunFolder, write_json, write_yaml

logger = logging.getLogger(__name__)

#: Control intervals that the classifier reads by default.
NUM_INTERVALS = 8


@dataclass(frozen=True, kw_only=True)
class LateralLineSettings(FitSettings):
    """Settings of a study of the lateral line, besides those of its fits (``FitSettings``).

    Args:
        task: task whose flows are classified; all of them, whatever ``task.start_flows`` is.
        preset: name of a preset; only its task is used.
        seed: of data, splits and fits.
        device: cpu or cuda, for the flows.
        compile: compile the flow solver.
        folder: where run folders lie.
        name: of the run folder; by default made from task and seed.
        data_folder: where collected data are kept, for every study that can use them.
        num_envs: flows that advance together.
        num_samples: decisions to collect, one signal of a control interval each.
        max_decisions: after which an episode is truncated.
        window: samples that the classifier reads, the newest; by default those of eight intervals.
        hidden: widths of its hidden layers.
        noise: added to the training signals, as a share of each feature's standard deviation.
        paper_epochs: epochs of the paper's classifier, which is fitted with its settings.
        num_splits: divisions of the episodes over which accuracies are averaged.
        windows: lengths of window to compare, in samples.
        noises: levels of noise to compare, as shares of each feature's standard deviation.
        memories: weights of earlier predictions to compare, see ``PredictedFlowLabel``.
    """

    task: Any = MISSING
    preset: str | None = None
    seed: int = bounded(0, least=0)
    device: str = "cpu"
    compile: bool = True
    folder: str = "runs"
    name: str | None = None
    data_folder: str = "runs/lateral_line_data"
    num_envs: int = bounded(16, least=1)
    num_samples: int = bounded(6000, least=1)
    max_decisions: int = bounded(60, least=1)
    window: int | None = bounded(None, least=1)
    hidden: tuple[int, ...] = bounded((128, 128), least=1)
    batch_size: int = bounded(256, least=1)
    patience: int | None = bounded(15, least=1)
    weight_decay: float = bounded(1e-3, least=0)
    noise: float = bounded(0.5, least=0)
    paper_epochs: int = bounded(1000, least=1)
    num_splits: int = bounded(2, least=1)
    windows: tuple[int, ...] = bounded((1, 2, 4, 8, 16), least=1)
    noises: tuple[float, ...] = bounded((0.0, 0.1, 0.2, 0.5, 1.0), least=0)
    memories: tuple[float, ...] = bounded((0.0, 0.7, 1.0), least=0)


def study_lateral_line(
    settings: LateralLineSettings,
    *,
    task: Any,
    episodes: TensorDict,
    folder: Path,
    progress: Progress,
) -> dict[str, Any]:
    """Fit the classifier and those to compare it with, to episodes as ``collect`` returns.

    Writes results and figures to the folder, and returns those of ``lateral_line.json``.
    """
    line, window = task.lateral_line, settings.window
    window = window or NUM_INTERVALS * line.num_samples
    study = Study(
        episodes=episodes,
        flows=task.flow_labels,
        layout=Collection(task=task).task.lateral_line_layout,
        hidden=settings.hidden,
        settings=settings,
        seed=settings.seed,
    )
    own = TrainingData(
        features=tuple(name for name in line.features if name not in BOOKKEEPING),
        num_samples=window,
        is_averaged=line.is_averaged,
        sensed=line.features,
    )
    progress.start("fits", total=2)
    fit = study.fit(own, noise=settings.noise)
    fit.classifier.save(folder / "machine.pt")
    progress.advance(1)
    paper = study.fit(
        next(iter(list_training_data(window).values())),
        settings=replace(FitSettings.of_the_paper(), num_epochs=settings.paper_epochs),
        max_samples=settings.num_samples,
        is_mirrored=False,
    )
    progress.advance(1)
    tables = answer(
        study,
        window=window,
        windows=settings.windows,
        noises=settings.noises,
        memories=settings.memories,
        num_splits=settings.num_splits,
        progress=progress,
    )
    findings = describe(study, fit, paper, tables, num_splits=settings.num_splits)
    write_json(folder / "lateral_line.json", findings)
    (folder / "lateral_line.md").write_text(write_page(findings), encoding="utf-8")
    write_figures(findings, {"this classifier": fit, "as in the paper": paper}, folder)
    return findings


@program(LateralLineSettings, groups={"task": "karman_gait", "preset": None})
def main(settings: LateralLineSettings) -> None:
    """Collect, fit and write a run folder."""
    task = make(settings.task, kind=AbstractTask)
    collection = Collection(
        task=task,
        num_envs=settings.num_envs,
        max_decisions=settings.max_decisions,
        seed=settings.seed,
    )
    name = settings.name or f"lateral-line-{type(task).__name__.lower()}-seed{settings.seed}"
    folder = RunFolder.create(parent=settings.folder, name=name)
    write_yaml(folder.config, to_plain(asdict(settings)))
    logger.info("run folder: %s", folder.path)
    with Progress() as progress:
        episodes = collect(
            collection,
            num_samples=settings.num_samples,
            folder=Path(settings.data_folder),
            device=settings.device,
            compile=settings.compile,
            progress=progress,
        )
        study_lateral_line(
            settings, task=task, episodes=episodes, folder=folder.path, progress=progress
        )
    print((folder.path / "lateral_line.md").read_text(encoding="utf-8"))
    print(f"written to {folder.path}")


if __name__ == "__main__":
    main()
