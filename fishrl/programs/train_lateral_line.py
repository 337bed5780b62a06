"""Train a lateral-line classifier: ``fishrl train-lateral-line seed=0``.

Collects labelled signals in every flow of a task, half under random actions and half under station
holding, and fits the classifier. Writes ``classifier.pt``, for ``recognition.path=``,
its accuracies (``lateral_line.json``), learning curves and confusion matrix.
``preset=gait_small`` trains one for the task of that preset. Collected data are kept: the same
command continues after an interruption, and other fits reuse them.
"""

import logging
from pathlib import Path

from tensordict import TensorDict

from fishrl.programs.lateral_line.collection import collect
from fishrl.programs.lateral_line.fitting import Fit, LateralLineSettings, fit
from fishrl.programs.lateral_line.report import describe, tabulate, write_figures
from fishrl.programs.program import program
from fishrl.settings import describe as describe_settings
from fishrl.training.callback import SILENT, Callback
from fishrl.training.progress import Progress
from fishrl.training.recognition import FILE
from fishrl.training.run_folder import RunFolder, write_json, write_yaml

logger = logging.getLogger(__name__)


def train_lateral_line(
    settings: LateralLineSettings, episodes: TensorDict, folder: Path, progress: Callback = SILENT
) -> dict[str, Fit]:
    """Fit the classifier to episodes as ``collect`` returns, and perhaps the paper's.

    Writes classifier, results and figures to the folder; returns the fits by name.
    """
    progress.on_phase("fits", total=1 + (settings.paper_epochs > 0))
    fits = {"classifier": fit(settings, episodes)}
    fits["classifier"].classifier.save(folder / FILE)
    progress.on_progress(1)
    if settings.paper_epochs:
        fits["paper"] = fit(settings.as_in_the_paper(), episodes)
        progress.on_progress(1)
    write_json(folder / "lateral_line.json", describe(episodes, fits))
    write_figures(fits, folder)
    return fits


@program(groups={"task": "karman_gait", "preset": None})
def main(settings: LateralLineSettings) -> None:
    """Collect, fit and write a run folder."""
    place = settings.place  # refuses a task without flows to tell apart
    task = type(settings.task).__name__.lower()
    name = settings.name or f"lateral-line-{task}-seed{settings.seed}"
    folder = RunFolder.create(parent=settings.folder, name=name)
    write_yaml(folder.config, describe_settings(settings))
    logger.info("run folder: %s, data: %s", folder.path, place)
    with Progress() as progress:
        fits = train_lateral_line(settings, collect(settings, progress), folder.path, progress)
    print(tabulate(fits))
    print(f"written to {folder.path}")
