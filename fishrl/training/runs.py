"""Start training runs and resume them."""

import logging
from collections.abc import Iterable
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

from fishrl.envs import AbstractTask, Recognition
from fishrl.settings import checked
from fishrl.training.algorithms import Algorithm
from fishrl.training.algorithms.discrete_sac import DiscreteSAC
from fishrl.training.callback import Callback
from fishrl.training.checkpoint import Checkpoint
from fishrl.training.interruption import handling_signals
from fishrl.training.logger import CsvLogger
from fishrl.training.loop import Training
from fishrl.training.opening import Opened, open_run
from fishrl.training.plan import Plan
from fishrl.training.settings import LearningSettings, RunSettings

logger = logging.getLogger(__name__)


@checked
def train(
    *,
    task: AbstractTask,
    algorithm: Algorithm | None = None,
    learning: LearningSettings | None = None,
    run: RunSettings | None = None,
    callbacks: Iterable[Callback] = (),
    recognition: Recognition | None = None,
    logger: CsvLogger | None = None,
    preset: str | None = None,
) -> dict[str, Any]:
    """Train a policy, compare it with the baselines of the task, and return the summary.

    If ``run.name`` names a run with these settings, it is continued unless it is finished.

    Args:
        task: the task.
        algorithm: the learning algorithm; by default ``DiscreteSAC()``.
        learning: settings that determine the result.
        run: where the run is written, and how often it evaluates, logs and saves.
        callbacks: called during the run, such as ``Progress()``.
        recognition: source of flow labels, ``Oracle()`` or ``Classifier(path=...)``.
        logger: writes the metrics; by default to a CSV file, or where the run did before.
        preset: name for these settings; part of the name of the run folder.

    Raises:
        ValueError: for invalid settings, or if they change the result of the run in the folder.
        Interrupted: after one of ``SIGNALS``; ``resume`` continues the run.
    """
    plan = Plan(
        task=task,
        algorithm=algorithm or DiscreteSAC(),
        logger=logger,
        preset=preset,
        recognition=recognition,
        **vars(learning or LearningSettings()),
        **vars(run or RunSettings()),
    )
    return _run(open_run(plan), callbacks)


@checked
def resume(
    folder: str | Path, /, *, callbacks: Iterable[Callback] = (), **changes: Any
) -> dict[str, Any]:
    """Resume a run from its last checkpoint unless it is finished, and return its summary.

    Args:
        folder: folder of the run.
        callbacks: see ``train``.
        **changes: new values of ``RunSettings``, such as ``total_frames=8000``.

    Raises:
        ValueError: if there is no run, its files do not load, or a change is not possible.
        Interrupted: see ``train``.
    """
    return _run(open_run(folder, **changes), callbacks)


def _run(opened: Opened, callbacks: Iterable[Callback]) -> dict[str, Any]:
    if opened.summary is not None:
        return opened.summary
    return complete(Training(opened, callbacks=callbacks))


@checked
def complete(training: Training) -> dict[str, Any]:
    """Run a training to its end and return the summary; on one of ``SIGNALS`` save and stop.

    If a process of its flows dies, the run continues from its last checkpoint; if one dies again
    before the next checkpoint, ``ChildProcessError`` is raised.
    """
    folder, resumed_at, interruption = training.folder, None, training.interruption
    with handling_signals(interruption.handle):
        while True:
            try:
                with folder.noting_failure(), closing(training):
                    return training.run()
            except ChildProcessError as error:
                if not folder.last.exists():  # it died before the first checkpoint
                    raise
                checkpoint = Checkpoint.read(folder.last)
                if checkpoint.frames == resumed_at:
                    raise
                resumed_at = checkpoint.frames
                logger.warning("%s; continuing from frame %d", error, resumed_at)
            training = Training(
                replace(training.opened, checkpoint=checkpoint),
                callbacks=[training.callbacks],
                interruption=interruption,  # it may have received a signal meanwhile
            )
