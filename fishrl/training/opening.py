"""Open a run: read its folder, compare settings, decide whether it begins, continues or ended."""

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from torchrl.envs import TransformedEnv

from fishrl.envs import AbstractTask, make_env
from fishrl.envs.extensions import HasFlowLabels, HasHistory, find_extension
from fishrl.extras import show_install
from fishrl.memory import check_memory
from fishrl.physics.fast.checks import check_device
from fishrl.settings import Role, checked, list_fields
from fishrl.training.baselines import choose_baselines
from fishrl.training.checkpoint import Checkpoint
from fishrl.training.plan import Plan
from fishrl.training.policy_spec import PolicySpec, check_senses
from fishrl.training.run_folder import CHANGED, HeldError, RunFolder, read_config, read_summary

logger = logging.getLogger(__name__)

#: Settings that a run keeps when it continues, regardless of the settings given.
_OWN = ("recognition", "folder", "name")


@dataclass(frozen=True, kw_only=True)
class Opened:
    """A run whose folder has been read; ``Training(opened)`` starts from it.

    Opening it changes nothing: the folder of a new run is made by ``enter``.
    """

    plan: Plan  #: its settings, adapted to the algorithm
    folder: RunFolder  #: its folder; a new one may get another name
    stored: dict[str, Any] = field(default_factory=dict)  #: ``config.yaml`` as read; {} if new
    checkpoint: Checkpoint | None = None  #: from which it continues
    result: dict[str, Any] | None = None  #: its result if only ``Callback.on_end`` is left
    summary: dict[str, Any] | None = None  #: its result if it is finished

    @cached_property
    def task(self) -> AbstractTask:
        """Task of the plan, which reads the flow labels if there are any."""
        recognition = self.plan.recognition
        return self.plan.task if recognition is None else recognition.check(self.plan.task)

    @cached_property
    def spec(self) -> PolicySpec:
        """Sizes of the policy."""
        return PolicySpec.for_task(
            self.task,
            hidden=self.plan.hidden,
            has_labels=self.plan.recognition is not None,
            reflect=self.plan.reflect,
        )

    @cached_property
    def initial(self) -> Checkpoint | None:
        """The policy whose weights a new run begins with."""
        plan = self.plan
        if plan.initial_policy is None or self.checkpoint is not None:
            return None
        found = Checkpoint.find(plan.initial_policy)
        other = Plan.from_config(found.config)
        pairs = {"algorithm": [type(each.algorithm).__name__ for each in (plan, other)]}
        for name, (wanted, stored) in (pairs | {"hidden": [plan.hidden, other.hidden]}).items():
            if wanted != stored:
                raise ValueError(
                    f"{name} = {wanted}: the initial_policy {plan.initial_policy} was trained with "
                    f"{stored}; take that, or another policy"
                )
        check_senses(plan.task, other.task, policy=plan.initial_policy)
        self.spec.check(found.manifest.metadata.model_dump(), path=found.path)
        return found

    @cached_property
    def baselines(self) -> tuple[str, ...]:
        """Names of the policies to compare with."""
        return choose_baselines(self.plan.baselines, self.task)

    @property
    def success(self) -> str:
        """Word for a successful episode: the task's ``success`` or ``survived``."""
        return self.task.success or "survived"

    @property
    def make_flows(self) -> Callable[..., TransformedEnv]:
        """Make its env, given ``flows`` and ``seed``."""
        return partial(
            make_env,
            task=self.plan.task,
            frames_per_action=self.task.checks_per_action,  # callbacks may read each
            recognition=self.plan.recognition,
        )

    def check(self) -> None:
        """Raise ValueError unless the settings fit together and this machine can run them.

        It comes before all that is slow, and before a folder is made.
        """
        plan = self.plan
        if self.summary is not None:
            raise ValueError(f"run folder {self.folder.path}: is finished; raise total_frames")
        if plan.ray_collectors:
            _check_cluster(plan)
        if plan.logger is not None:
            plan.logger.check()
        check_device(plan.flows.device)
        check_device(plan.policy_device)
        for device, parts in self.count_bytes().items():
            check_memory(device=device, **parts)
        is_observed = find_extension(self.task, HasFlowLabels).num_label_inputs > 0
        is_read = is_observed or bool(find_extension(self.task, HasHistory).inputs)
        if plan.recognition is not None and not is_read:
            logger.warning(
                "recognition: the policy does not observe flow_label, and no action depends on the "
                "flow; recognition=null learns the same"
            )
        _ = self.baselines, self.initial
        if self.checkpoint is not None:
            _ = self.checkpoint.files

    def count_bytes(self) -> dict[str, dict[str, float]]:
        """Return by device what will fill its memory at once, and how much, bytes."""
        plan, spec, config = self.plan, self.spec, self.task.flow_config()
        transition = 2 * (spec.num_inputs + spec.num_critic_inputs + spec.num_actions)
        transition += plan.algorithm.count_states(plan)
        # the eager step of the flows that advance together has some forty-five temporary fields
        together = plan.flows.num_envs if plan.flows.device != "cpu" else 1
        copies = 2 * plan.flows.num_envs + (0 if plan.flows.compile else 5 * together)
        needed: dict[str, dict[str, float]] = {plan.flows.device: {}, plan.policy_device: {}}
        needed[plan.flows.device]["flows and their copy at evaluations and checkpoints"] = (
            copies * config.num_bytes
        )
        needed[plan.policy_device]["buffer"] = (
            4 * transition * plan.buffer_size * self.task.num_fish
        )
        return needed

    def enter(self) -> "Opened":
        """Return the run with its folder, which is made for a new one, with its classifier."""
        plan, folder, is_named = self.plan, self.folder, self.plan.name is not None
        if not self.stored:
            folder = RunFolder.create(parent=plan.folder, name=plan.folder_name, reuse=is_named)
        if plan.recognition is not None and self.checkpoint is None:
            plan = replace(plan, recognition=plan.recognition.keep(folder.path))
        return replace(self, plan=plan, folder=folder, stored=self.stored or plan.to_config())

    def check_current(self, folder: RunFolder) -> None:
        """Raise HeldError if another process has continued the run since it was read."""
        frames = Checkpoint.read(folder.last).frames if folder.has_begun() else None
        known = None if self.checkpoint is None else self.checkpoint.frames
        if frames != known or folder.config.is_file() != bool(self.stored):
            raise HeldError(f"run folder {folder.path}: {CHANGED}")


@checked
def open_run(run: Plan | str | Path, /, **changes: Any) -> Opened:
    """Open the run of these settings, or the run in a folder.

    If the folder of the settings holds a run, it keeps its folder, name and classifier, and its
    logger unless one is given. One that failed before its first checkpoint takes new settings.

    Args:
        run: settings, or the folder of a run.
        **changes: new values of ``RunSettings``, such as ``total_frames=8000``.

    Raises:
        ValueError: naming each setting that fixes the result and differs from the run's; if there
            is no run in the folder, its files do not load, or a change is not possible.
    """
    if isinstance(run, Plan):
        run = replace(run, **run.algorithm.adapt(run)).change(**changes)
        folder = RunFolder(run.path or Path(run.folder).expanduser() / run.folder_name)
        if run.path is None or not folder.config.is_file():
            return Opened(plan=run, folder=folder)
        config = read_config(folder.config)
        stored = type(run).from_config(config)
        plan = replace(run, logger=run.logger or stored.logger)
        if folder.failure.is_file() and not folder.has_begun():
            return Opened(plan=plan, folder=folder, stored=config)
        _refuse_other(run, stored, folder.path)
        plan = replace(plan, **{name: getattr(stored, name) for name in _OWN})
    else:
        folder = RunFolder.of_existing(run)
        config = read_config(folder.config)
        stored = Plan.from_config(config)
        for key in changes.keys() & {"name", "folder"}:
            raise ValueError(f"{key}: is fixed in {folder.path}; leave it out, or start a new run")
        plan = stored.change(**changes)
    opened = Opened(plan=plan, folder=folder, stored=config)
    summary = read_summary(folder.summary).items()
    # JSON has no NaN, the mean of nothing
    result = {n: math.nan if value is None and "mean_" in n else value for n, value in summary}
    has_result = plan.total_frames <= result.get("frames", 0)
    has_result &= _evaluates_alike(plan, stored, Plan)
    is_cut_off = folder.ending.is_file() or folder.failure.is_file()
    if has_result and not is_cut_off and _evaluates_alike(plan, stored, type(plan)):
        return replace(opened, summary=result)
    if not folder.has_begun():
        return opened
    checkpoint = Checkpoint.read(folder.last)
    _refuse_other(plan, Plan.from_config(checkpoint.config), checkpoint.path)  # it has a checksum
    has_result &= checkpoint.frames == result.get("frames")
    return replace(opened, checkpoint=checkpoint, result=result if has_result else None)


def _evaluates_alike(plan: Plan, stored: Plan, kind: type[Plan]) -> bool:
    """Return whether the fields of ``kind`` ask for the same final evaluation.

    Those that a program adds to ``Plan`` concern ``Callback.on_end``.
    """
    late = [entry.name for entry in list_fields(kind) if entry.role is Role.EVALUATION]
    return all(getattr(plan, name) == getattr(stored, name) for name in late)


def _refuse_other(plan: Plan, stored: Plan, path: Path) -> None:
    """Raise ValueError naming each setting that fixes the result and differs from those stored."""
    different = plan.list_differences(stored)
    if different:
        lines = [f"{key} = {new}: is {old} in {path}" for key, (new, old) in different.items()]
        raise ValueError("\n".join(lines) + "; take another folder or name, or change it back")


def _check_cluster(plan: Plan) -> None:
    device = plan.flows.device
    if device not in ("cpu", "cuda") or plan.learner_device is not None:
        raise ValueError(
            f"flows.device = {device}, learner_device = {plan.learner_device}: with ray_collectors "
            "flows.device must be cpu, or cuda, where each collector has its own GPU, and "
            "learner_device null"
        )
    if find_spec("ray") is None:
        raise ValueError(f"ray_collectors: needs Ray: {show_install('cluster')}")
