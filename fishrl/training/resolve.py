"""Resolve a run: everything that follows from its settings, checked before anything slow."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path

from torchrl.envs import EnvBase, Transform

from fishrl.envs import AbstractTask
from fishrl.envs import make_env as make_flow_env
from fishrl.envs.transforms import equip, make_labelling
from fishrl.extras import show_install
from fishrl.memory import check_memory
from fishrl.training.baselines import choose_baselines
from fishrl.training.classifier import Recognition, load_recognition
from fishrl.training.plan import Plan
from fishrl.training.policy_spec import PolicySpec
from fishrl.training.settings import check_device

#: Makes an environment of a task; see ``fishrl.envs.make_env``.
MakeEnv = Callable[..., EnvBase]


@dataclass(frozen=True, kw_only=True)
class ResolvedRun:
    """A run whose settings fit together and can run on this machine; ``resolve`` makes it.

    Attributes:
        plan: its settings.
        recognition: source of flow labels, as ``fishrl.envs.make_env`` takes it.
        task: task of the plan, which reads the flow labels if there are any.
        spec: sizes of its policy.
        baselines: names of the policies to compare with.
        make_env: makes its flows.
    """

    plan: Plan
    recognition: Recognition
    task: AbstractTask
    spec: PolicySpec
    baselines: tuple[str, ...]
    make_env: MakeEnv = make_flow_env

    @property
    def success(self) -> str:
        """Word for a successful episode: the task's ``success`` or ``survived``."""
        return self.task.success or "survived"

    def compute_mlups(self, num_frames: int, seconds: float) -> float:
        """Return million lattice node updates per second, with sensing and policy included."""
        flow = self.task.flow_config()
        num_nodes = flow.width * flow.height * self.task.n_substeps
        return num_nodes * num_frames / max(seconds, 1e-9) / 1e6

    def make_flows(
        self, *, num_envs: int, seed: int, transforms: Sequence[Transform] = ()
    ) -> EnvBase:
        """Make flows with their labels and with copies of further ``transforms``."""
        env = self.make_env(
            task=self.task,
            num_envs=num_envs,
            seed=seed,
            device=self.plan.run.device,
            compile=self.plan.run.compile,
            frames_per_action=self.task.checks_per_action,  # callbacks may read each
            transforms=make_labelling(self.task, self.recognition),
        )
        for transform in transforms:
            env.append_transform(transform.clone())
        return env


def resolve(
    plan: Plan,
    *,
    recognition: Recognition = None,
    folder: Path = Path(),
    make_env: MakeEnv = make_flow_env,
) -> ResolvedRun:
    """Check the settings of a run and resolve what follows from them.

    ``recognition`` may be the file of a classifier; one of the run itself lies in its ``folder``.

    Raises:
        ValueError: for settings that do not fit together, the task or this machine.
    """
    _check_devices(plan)
    labels = load_recognition(recognition, folder)
    task = equip(plan.task, labels)
    has_labels, hidden = labels is not None, plan.learning.hidden
    spec = PolicySpec.for_task(task, hidden=hidden, has_labels=has_labels)
    _check_memory(plan, task, spec)
    return ResolvedRun(
        plan=plan,
        recognition=labels,
        task=task,
        spec=spec,
        baselines=choose_baselines(plan.run.baselines, task),
        make_env=make_env,
    )


def _check_devices(plan: Plan) -> None:
    run = plan.run
    check_device(run.device)
    check_device(run.policy_device)
    if not plan.learning.ray_collectors:
        return
    if run.device not in ("cpu", "cuda") or run.learner_device is not None:
        raise ValueError(
            f"device = {run.device}, learner_device = {run.learner_device}: with ray_collectors "
            "device must be cpu, or cuda, where each collector has a GPU of its own, and "
            "learner_device null"
        )
    if find_spec("ray") is None:
        raise ValueError(f"ray_collectors: needs Ray: {show_install('cluster')}")


def _check_memory(plan: Plan, task: AbstractTask, spec: PolicySpec) -> None:
    run, learning = plan.run, plan.learning
    transition = 2 * (spec.num_inputs + spec.num_actions)
    weights = sum(a * b for a, b in pairwise((spec.num_observed, *learning.hidden)))
    needed: dict[str, dict[str, float]] = {run.device: {}, run.policy_device: {}}
    needed[run.device]["flows"] = task.flow_config().num_bytes * learning.num_envs
    needed[run.policy_device] |= {
        "buffer": 4 * transition * learning.buffer_size * task.num_fish,
        "networks": 4 * 4 * weights,  # values, gradients and Adam's two means
    }
    for device, parts in needed.items():
        check_memory(device=device, **parts)
