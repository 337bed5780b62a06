"""Start training runs and resume them."""

import logging
from collections.abc import Iterable
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from fishrl.envs import AbstractTask, Recognition
from fishrl.settings import Role, list_fields
from fishrl.training.algorithms import Algorithm
from fishrl.training.algorithms.discrete_sac import DiscreteSAC
from fishrl.training.callback import Callback
from fishrl.training.checkpoint import check_checkpoint, read_metadata
from fishrl.training.interruption import handling_signals
from fishrl.training.logger import CsvLogger
from fishrl.training.loop import Training
from fishrl.training.plan import Plan
from fishrl.training.resolve import resolve
from fishrl.training.run_folder import RunFolder, read_config, read_summary, write_yaml
from fishrl.training.settings import LearningSettings, RunSettings

logger = logging.getLogger(__name__)

P = TypeVar("P", bound=Plan)


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
        logger: writes the metrics; by default to a CSV file.
        preset: name for these settings; part of the name of the run folder.

    Raises:
        ValueError: for invalid settings, or if they change the result of the run in the folder.
        Interrupted: after one of ``SIGNALS``; ``resume`` continues the run.
    """
    plan = Plan(
        task=task,
        algorithm=algorithm or DiscreteSAC(),
        logger=logger or CsvLogger(),
        preset=preset,
        recognition=recognition,
        **vars(learning or LearningSettings()),
        **vars(run or RunSettings()),
    )
    return find_result(plan) or complete(begin(plan, callbacks=callbacks))


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
    run = RunFolder.of_existing(folder)
    plan = Plan.from_config(read_config(run.config)).change(**changes)
    return read_result(run, plan) or complete(_continue(run, plan, callbacks))


def find_run(plan: Plan) -> RunFolder | None:
    """Return the folder that a plan names if it holds a run."""
    folder = None if plan.path is None else RunFolder(plan.path)
    return folder if folder is not None and folder.config.is_file() else None


def adopt_plan(folder: RunFolder, plan: P) -> P:
    """Return a plan as the run in a folder continues with it: with its own logger, folder and name.

    Raises:
        ValueError: naming each setting that fixes the result and differs from the run's.
    """
    stored = type(plan).from_config(read_config(folder.config))
    _refuse_other(plan, stored, folder.path)
    return replace(
        plan,
        recognition=stored.recognition,
        logger=stored.logger,
        folder=stored.folder,
        name=stored.name,
    )


def _refuse_other(plan: Plan, stored: Plan, path: Path) -> None:
    """Raise ValueError naming each setting that fixes the result and differs from those stored."""
    different = plan.list_differences(stored)
    if different:
        lines = [f"{key} = {new}: is {old} in {path}" for key, (new, old) in different.items()]
        raise ValueError("\n".join(lines) + "; take another folder or name, or change it back")


def read_result(folder: RunFolder, plan: Plan) -> dict[str, Any] | None:
    """Return the summary of a run that is finished, also with the settings of a plan, or None.

    More frames or another final evaluation make it unfinished.
    """
    if not folder.summary.is_file() or folder.failure.is_file():
        return None
    summary = read_summary(folder.summary)
    stored = type(plan).from_config(read_config(folder.config))
    late = [entry.name for entry in list_fields(type(plan)) if entry.role is Role.EVALUATION]
    is_same = all(getattr(plan, name) == getattr(stored, name) for name in late)
    return summary if is_same and plan.total_frames <= summary.get("frames", 0) else None


def find_result(plan: Plan) -> dict[str, Any] | None:
    """Return the summary of the run that a plan names, see ``read_result``, or None.

    Raises:
        ValueError: see ``adopt_plan``.
    """
    folder = find_run(plan)
    return None if folder is None else read_result(folder, adopt_plan(folder, plan))


def begin(plan: Plan, *, callbacks: Iterable[Callback] = ()) -> Training:
    """Set up a run: a new one, or the one that ``plan.path`` names as its last checkpoint left it.

    Args:
        plan: the settings; invalid ones raise an error before a folder is made.
        callbacks: see ``train``.

    Raises:
        ValueError: for invalid settings, or if others fix the result of the run in the folder.
    """
    found = find_run(plan)
    if found is not None:
        return _continue(found.checked(), adopt_plan(found, plan), callbacks)
    resolved = resolve(plan)
    folder, plan = make_folder(plan)
    logger.info("run folder: %s", folder.path)
    with folder.noting_failure():
        return Training(replace(resolved, plan=plan), folder=folder, callbacks=callbacks)


def make_folder(plan: Plan) -> tuple[RunFolder, Plan]:
    """Write everything a run needs into a new folder, for ``resume``.

    Returns:
        The folder, and the plan as written there; the file of a classifier is copied.
    """
    is_named = plan.name is not None
    folder = RunFolder.create(parent=plan.folder, name=plan.folder_name, reuse=is_named)
    if plan.recognition is not None:
        plan = replace(plan, recognition=plan.recognition.keep(folder.path))
    write_yaml(folder.config, plan.to_config())
    return folder, plan


def reopen(
    folder: str | Path, /, *, callbacks: Iterable[Callback] = (), **changes: Any
) -> Training:
    """Set up a run in the state of its last checkpoint; see ``resume``."""
    run = RunFolder.of_existing(folder)
    with run.noting_failure():
        plan = Plan.from_config(read_config(run.config)).change(**changes)
    return _continue(run, plan, callbacks)


def _continue(folder: RunFolder, plan: Plan, callbacks: Iterable[Callback]) -> Training:
    """Set up the run in a folder with settings that fit it."""
    with folder.noting_failure():
        if folder.has_begun():  # its config.yaml has no checksum
            path, metadata = read_metadata(folder.path, which="last")
            check_checkpoint(path)
            _refuse_other(plan, Plan.from_config(metadata["config"]), path)
        training = Training(resolve(plan), folder=folder, callbacks=callbacks)
        if folder.has_begun():
            try:
                training.restore()
            except ValueError:
                training.close()
                raise
            folder.summary.unlink(missing_ok=True)  # it will be replaced
        write_yaml(folder.config, read_config(folder.config) | plan.to_config())
        return training


def complete(training: Training) -> dict[str, Any]:
    """Run a training to its end and return the summary; on one of ``SIGNALS`` save and stop.

    If a process of its flows dies, the run continues from its last checkpoint; if one dies again
    before the next checkpoint, ``ChildProcessError`` is raised.
    """
    folder, resumed_at = training.folder, None
    interruption = training.interruption
    with handling_signals(interruption.handle):
        while True:
            try:
                with folder.noting_failure(), closing(training):
                    return training.run()
            except ChildProcessError as error:
                if not folder.last.exists():  # it died before the first checkpoint
                    raise
                frames = read_metadata(folder.path, which="last")[1]["frames"]
                if frames == resumed_at:
                    raise
                logger.warning("%s; continuing from frame %d", error, frames)
                resumed_at = frames
            with folder.noting_failure():
                training = Training(
                    training.resolved,
                    folder=folder,
                    callbacks=[training.callbacks],
                    interruption=interruption,  # it may have received a signal meanwhile
                )
                training.restore()
