"""Resolve a run: everything that follows from its settings, checked before anything slow."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec

from torchrl.envs import TransformedEnv

from fishrl.envs import AbstractTask, make_env
from fishrl.extras import show_install
from fishrl.memory import check_memory
from fishrl.physics.fast.checks import check_device
from fishrl.training.baselines import choose_baselines
from fishrl.training.plan import Plan
from fishrl.training.policy_spec import PolicySpec


@dataclass(frozen=True, kw_only=True)
class ResolvedRun:
    """A run whose settings fit together and can run on this machine; ``resolve`` makes it."""

    plan: Plan  #: its settings
    task: AbstractTask  #: task of the plan, which reads the flow labels if there are any
    spec: PolicySpec  #: sizes of its policy
    baselines: tuple[str, ...]  #: names of the policies to compare with
    make_flows: Callable[..., TransformedEnv]  #: makes its env, given ``flows`` and ``seed``

    @property
    def success(self) -> str:
        """Word for a successful episode: the task's ``success`` or ``survived``."""
        return self.task.success or "survived"

    def compute_mlups(self, num_frames: int, seconds: float) -> float:
        """Return million lattice node updates per second, with sensing and policy included."""
        flow = self.task.flow_config()
        num_nodes = flow.width * flow.height * self.task.n_substeps
        return num_nodes * num_frames / max(seconds, 1e-9) / 1e6


def resolve(plan: Plan) -> ResolvedRun:
    """Check the settings of a run and resolve what follows from them.

    Raises:
        ValueError: for settings that do not fit together, the task or this machine.
    """
    _check_devices(plan)
    labels = plan.recognition
    task = plan.task if labels is None else labels.check(plan.task)
    spec = PolicySpec.for_task(task, hidden=plan.hidden, has_labels=labels is not None)
    _check_memory(plan, task, spec)
    return ResolvedRun(
        plan=plan,
        task=task,
        spec=spec,
        baselines=choose_baselines(plan.baselines, task),
        make_flows=partial(
            make_env,
            task=task,
            frames_per_action=task.checks_per_action,  # callbacks may read each
            recognition=labels,
        ),
    )


def _check_devices(plan: Plan) -> None:
    check_device(plan.flows.device)
    check_device(plan.policy_device)
    if not plan.ray_collectors:
        return
    device = plan.flows.device
    if device not in ("cpu", "cuda") or plan.learner_device is not None:
        raise ValueError(
            f"flows.device = {device}, learner_device = {plan.learner_device}: with ray_collectors "
            "flows.device must be cpu, or cuda, where each collector has a GPU of its own, and "
            "learner_device null"
        )
    if find_spec("ray") is None:
        raise ValueError(f"ray_collectors: needs Ray: {show_install('cluster')}")


def _check_memory(plan: Plan, task: AbstractTask, spec: PolicySpec) -> None:
    transition = 2 * (spec.num_inputs + spec.num_actions)
    device = plan.flows.device
    needed: dict[str, dict[str, float]] = {device: {}, plan.policy_device: {}}
    needed[device]["flows"] = task.flow_config().num_bytes * plan.flows.num_envs
    needed[plan.policy_device]["networks"] = plan.algorithm.count_bytes(spec)
    needed[plan.policy_device]["buffer"] = 4 * transition * plan.buffer_size * task.num_fish
    for device, parts in needed.items():
        check_memory(device=device, **parts)
