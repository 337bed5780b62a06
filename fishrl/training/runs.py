"""Start training runs and resume them."""

import logging
from collections.abc import Iterable, Mapping
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

from fishrl.envs import AbstractTask, make_env
from fishrl.training.algorithms import Algorithm
from fishrl.training.algorithms.discrete_sac import DiscreteSAC
from fishrl.training.callback import Callback
from fishrl.training.checkpoint import read_metadata
from fishrl.training.classifier import Recognition, keep_recognition
from fishrl.training.continuation import find_changes, find_summary, read_plan
from fishrl.training.logger import CsvLogger
from fishrl.training.loop import Training
from fishrl.training.plan import Plan
from fishrl.training.resolve import MakeEnv, resolve
from fishrl.training.run_folder import RunFolder, write_yaml
from fishrl.training.settings import LearningSettings, RunSettings

logger = logging.getLogger(__name__)


def train(
    *,
    task: AbstractTask,
    algorithm: Algorithm | None = None,
    learning: LearningSettings | None = None,
    run: RunSettings | None = None,
    callbacks: Iterable[Callback] = (),
    recognition: Recognition = None,
    logger: CsvLogger | None = None,
    preset: str | None = None,
    extra: Mapping[str, Any] | None = None,
    make_env: MakeEnv = make_env,
) -> dict[str, Any]:
    """Train a policy, compare it with the baselines of the task, and return the summary.

    If ``run.name`` names a run with these settings, it is continued unless it is finished.

    Args:
        task: the task.
        algorithm: the learning algorithm; by default ``DiscreteSAC()``.
        learning: settings that determine the result.
        run: where the run is written, and how often it evaluates, logs and saves.
        callbacks: called during the run, such as ``Progress()``.
        recognition: source of flow labels, see ``fishrl.envs.make_env``, or a classifier file.
        logger: writes the metrics; by default to a CSV file.
        preset: name for these settings; part of the name of the run folder.
        extra: further settings, of other names, to keep in ``config.yaml``.
        make_env: makes the flows, with the arguments of ``fishrl.envs.make_env``.

    Raises:
        ValueError: for invalid settings, or if they change the result of the run in the folder.
        Interrupted: after SIGINT or SIGTERM; ``resume`` continues the run.
    """
    plan = Plan(
        task=task,
        algorithm=algorithm or DiscreteSAC(),
        learning=learning or LearningSettings(),
        run=run or RunSettings(),
        logger=logger or CsvLogger(),
        preset=preset,
        extra=extra or {},
    )
    if plan.path is not None and RunFolder(plan.path).config.is_file():
        changes = find_changes(plan.path, plan, recognition=recognition)
        return resume(plan.path, callbacks=callbacks, make_env=make_env, **changes)
    return complete(begin(plan, recognition=recognition, callbacks=callbacks, make_env=make_env))


def resume(
    folder: str | Path,
    /,
    *,
    callbacks: Iterable[Callback] = (),
    make_env: MakeEnv = make_env,
    **changes: Any,
) -> dict[str, Any]:
    """Resume a run from its last checkpoint unless it is finished, and return its summary.

    Args:
        folder: folder of the run.
        callbacks: see ``train``.
        make_env: see ``train``.
        **changes: new values of ``RunSettings``, such as ``total_frames=8000``.

    Raises:
        ValueError: if there is no run, its files do not load, or a change is not possible.
        Interrupted: see ``train``.
    """
    summary = find_summary(folder, **changes)
    if summary is not None:
        return summary
    opened = reopen(folder, callbacks=callbacks, make_env=make_env, **changes)
    return complete(opened)


def begin(
    plan: Plan,
    *,
    folder: Path | None = None,
    recognition: Recognition = None,
    callbacks: Iterable[Callback] = (),
    make_env: MakeEnv = make_env,
) -> Training:
    """Set up a run: a new one, or the one in its folder in the state of its last checkpoint.

    Args:
        plan: the settings; invalid ones raise an error before a folder is made.
        folder: run folder; by default the one that ``plan.run.name`` names, or a new one.
        recognition: see ``train``.
        callbacks: see ``train``.
        make_env: see ``train``.

    Raises:
        ValueError: for invalid settings, or if others fix the result of the run in the folder.
    """
    path = folder or plan.path
    if path is not None and RunFolder(path).config.is_file():
        changes = find_changes(path, plan, recognition=recognition)
        return reopen(path, callbacks=callbacks, make_env=make_env, **changes)
    resolved = resolve(plan, recognition=recognition, make_env=make_env)
    run, plan = make_folder(plan, recognition=recognition)
    with run.noting_failure():
        return Training(replace(resolved, plan=plan), folder=run, callbacks=callbacks)


def make_folder(plan: Plan, *, recognition: Recognition = None) -> tuple[RunFolder, Plan]:
    """Write everything a run needs into a new folder, for ``resume``.

    Returns:
        The folder, and the plan as written there; the file of a classifier is copied.
    """
    is_named = plan.run.name is not None
    folder = RunFolder.create(parent=plan.run.folder, name=plan.name, reuse=is_named)
    plan = replace(plan, recognition=keep_recognition(recognition, folder.path))
    write_yaml(folder.config, plan.to_config())
    return folder, plan


def reopen(
    folder: str | Path,
    /,
    *,
    callbacks: Iterable[Callback] = (),
    make_env: MakeEnv = make_env,
    **changes: Any,
) -> Training:
    """Set up a run in the state of its last checkpoint; see ``resume``."""
    run = RunFolder.of_existing(folder)
    with run.noting_failure():
        stored = read_plan(run)
        plan = stored.change(**changes)
        resolved = resolve(plan, recognition=plan.recognition, folder=run.path, make_env=make_env)
        training = Training(resolved, folder=run, callbacks=callbacks)
        if run.has_begun():
            try:
                training.restore()
            except ValueError:
                training.close()
                raise
            run.summary.unlink(missing_ok=True)  # it will be replaced
        if plan != stored:
            write_yaml(run.config, plan.to_config())
        return training


def complete(training: Training) -> dict[str, Any]:
    """Run a training to its end and return the summary; on SIGINT or SIGTERM save and stop.

    If a process of its flows dies, the run continues from its last checkpoint; if one dies again
    before the next checkpoint, ``ChildProcessError`` is raised.
    """
    folder, resumed_at = training.folder, None
    with training.interruption as interruption:
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
