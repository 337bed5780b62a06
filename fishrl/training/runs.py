"""Start training runs and resume them."""

from __future__ import annotations

import logging
import time
from collections.abc import Collection, Mapping
from contextlib import closing
from dataclasses import replace
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from typing import Any

from fishrl.envs import AbstractTask
from fishrl.envs.transforms import equip
from fishrl.extras import show_install
from fishrl.memory import check_memory
from fishrl.training.algorithms import Algorithm
from fishrl.training.algorithms.discrete_sac import DiscreteSAC
from fishrl.training.baselines import make_baselines
from fishrl.training.checkpoint import read_metadata
from fishrl.training.classifier import Recognition, keep_recognition, load_recognition
from fishrl.training.logger import CsvLogger
from fishrl.training.loop import Training
from fishrl.training.observer import Hooks
from fishrl.training.plan import Plan
from fishrl.training.policy_spec import PolicySpec
from fishrl.training.run_folder import RunFolder, read_config, read_summary, write_yaml
from fishrl.training.settings import LearningSettings, RunSettings, check_device

logger = logging.getLogger(__name__)


def train(
    *,
    task: AbstractTask,
    algorithm: Algorithm | None = None,
    learning: LearningSettings | None = None,
    run: RunSettings | None = None,
    recognition: Recognition = None,
    logger: CsvLogger | None = None,
    preset: str | None = None,
    extra: Mapping[str, Any] | None = None,
    **hooks: Any,
) -> dict[str, Any]:
    """Train a policy, compare it with the baselines of the task, and return the summary.

    Args:
        task: the task.
        algorithm: the learning algorithm; by default ``DiscreteSAC()``.
        learning: settings that determine the result.
        run: where the run is written, and how often it evaluates, logs and saves.
        recognition: source of flow labels, see ``fishrl.envs.make_env``, or a classifier file.
        logger: writes the metrics; by default to a CSV file.
        preset: name for these settings; part of the name of the run folder.
        extra: further settings, of other names, to keep in ``config.yaml``.
        **hooks: ``make_env``, ``observer``, ``progress`` and ``began``, see ``Hooks``.

    Raises:
        ValueError: for invalid settings.
        TypeError: for other keywords.
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
    return complete(begin(plan, recognition=recognition, **hooks))


def resume(
    folder: str | Path, /, *, modules: Collection[str] = (), **changes: Any
) -> dict[str, Any]:
    """Resume a run from its last checkpoint unless it is finished, and return its summary.

    Args:
        folder: folder of the run.
        modules: modules outside fishrl that may be imported, see ``description.make``.
        **changes: new values of ``RunSettings``, such as ``total_frames=8000``, and hooks, see
            ``train``.

    Raises:
        ValueError: if there is no run, its files do not load, or a change is not possible.
        Interrupted: see ``train``.
    """
    settings = {name: changes[name] for name in changes if name not in Hooks.__annotations__}
    summary = find_summary(folder, modules=modules, **settings)
    if summary is not None:
        return summary
    return complete(reopen(folder, modules=modules, **changes))


def begin(plan: Plan, *, recognition: Recognition = None, **hooks: Any) -> Training:
    """Set up a new run; invalid settings raise an error before its folder is made."""
    given, labels = Hooks(**hooks), load_recognition(recognition)
    _check(plan, labels)
    folder, plan = make_folder(plan, recognition=recognition)
    with folder.noting_failure():
        return Training(plan, recognition=labels, folder=folder, hooks=given)


def make_folder(
    plan: Plan, *, recognition: Recognition = None, folder: RunFolder | None = None
) -> tuple[RunFolder, Plan]:
    """Write everything a run needs into a folder, by default a new one, for ``resume``.

    Returns:
        The folder, and the plan as written there; the file of a classifier is copied.
    """
    folder = folder or RunFolder.create(parent=plan.run.folder, name=plan.name)
    plan = replace(plan, recognition=keep_recognition(recognition, folder.path))
    write_yaml(folder.config, plan.to_config())
    return folder, plan


def reopen(folder: str | Path, /, *, modules: Collection[str] = (), **changes: Any) -> Training:
    """Set up a run in the state of its last checkpoint; see ``resume``."""
    names = Hooks.__annotations__.keys() & changes
    hooks = Hooks(**{name: changes.pop(name) for name in names})
    run = RunFolder.of_existing(folder)
    with run.noting_failure():
        stored = Plan.from_config(read_config(run.config), modules=modules)
        plan = stored.change(**changes)
        labels = load_recognition(plan.recognition, run.path)
        _check(plan, labels)
        training = Training(plan, recognition=labels, folder=run, hooks=hooks)
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
    hooks = vars(training.hooks)
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
                logger.warning("%s; going on from frame %d", error, frames)
                resumed_at = frames
            training = reopen(folder.path, **hooks | {"began": time.perf_counter()})
            training.interruption = interruption  # it may have received a signal meanwhile


def find_summary(
    folder: str | Path, /, *, modules: Collection[str] = (), **changes: Any
) -> dict[str, Any] | None:
    """Return the summary of a run that is finished, also under some changes, or None.

    More frames or another final evaluation make it unfinished; arguments see ``resume``.
    """
    run = RunFolder.of_existing(folder)
    if not run.summary.is_file() or run.failure.is_file():
        return None
    summary = read_summary(run.summary)
    stored = Plan.from_config(read_config(run.config), modules=modules)
    plan = stored.change(**changes)
    same = (
        plan.run.final_episodes == stored.run.final_episodes
        and plan.run.baselines == stored.run.baselines
        and plan.extra == stored.extra
        and plan.run.total_frames <= summary.get("frames", 0)
    )
    return dict(summary) if same else None


def _check(plan: Plan, recognition: Recognition) -> None:
    """Raise for a plan that cannot run, before anything slow starts."""
    run = plan.run
    check_device(run.device)
    check_device(run.policy_device)
    if plan.learning.ray_collectors:
        if run.device not in ("cpu", "cuda") or run.learner_device is not None:
            raise ValueError(
                f"device = {run.device}, learner_device = {run.learner_device}: with "
                "ray_collectors device must be cpu, or cuda, where each collector has a GPU of its "
                "own, and learner_device null"
            )
        if find_spec("ray") is None:
            raise ValueError(f"ray_collectors: needs Ray: {show_install('cluster')}")
    task, _ = equip(plan.task, recognition)
    learning, sizes = plan.learning, PolicySpec.for_task(task, has_labels=recognition is not None)
    transition = 2 * (sizes.num_inputs + sizes.num_actions)
    weights = sum(a * b for a, b in pairwise((sizes.num_observed, *learning.hidden)))
    needed: dict[str, dict[str, float]] = {run.device: {}, run.policy_device: {}}
    needed[run.device]["flows"] = task.flow_config().num_bytes * learning.num_envs
    needed[run.policy_device] |= {
        "buffer": 4 * transition * learning.buffer_size * task.num_fish,
        "networks": 4 * 4 * weights,  # values, gradients and Adam's two means
    }
    for device, parts in needed.items():
        check_memory(device=device, **parts)
    make_baselines(plan.run.baselines, task=task, seed=0)
