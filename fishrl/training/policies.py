"""Load learned policies from checkpoints, and evaluate policies."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from types import EllipsisType
from typing import Any

from tensordict.nn import TensorDictModuleBase

from fishrl.envs import AbstractTask, Flows, Recognition, make_env
from fishrl.envs.episodes import Policy, run_episodes
from fishrl.physics.fast.checks import check_device
from fishrl.torch_state import in_own_state
from fishrl.training.baselines import make_baseline
from fishrl.training.callback import Callback, join
from fishrl.training.checkpoint import Checkpoint
from fishrl.training.evaluation import fixed_starts
from fishrl.training.plan import Plan
from fishrl.training.policy_spec import PolicySpec


def load_plan(checkpoint: str | Path) -> Plan:
    """Return the settings of a run: its task and recognition, for ``make_env``, and all others.

    Args:
        checkpoint: run folder, checkpoint, or ``zoo/<name>`` for a policy of ``fishrl.zoo``.

    Errors are those of ``Plan.from_config`` and ``Checkpoint.find``.
    """
    return Plan.from_config(Checkpoint.find(checkpoint).config)


@in_own_state
def load_policy(
    checkpoint: str | Path,
    *,
    task: AbstractTask | None = None,
    has_labels: bool | None = None,
    device: str = "cpu",
) -> TensorDictModuleBase:
    """Load a learned policy.

    It samples its actions. Under ``torchrl.envs.set_exploration_type`` with
    ``ExplorationType.DETERMINISTIC``, as in evaluations, it takes the most probable ones.

    Args:
        checkpoint: run folder, checkpoint, or ``zoo/<name>`` for a policy of ``fishrl.zoo``.
        task: the task to act in; by default the task of its run.
        has_labels: whether transforms label the flows of the task; by default as in its run.
        device: device of the policy.

    Errors are those of ``load_plan``.
    """
    found = Checkpoint.find(checkpoint)
    plan = Plan.from_config(found.config)
    if has_labels is None:
        has_labels = plan.recognition is not None
    spec = PolicySpec.for_task(task or plan.task, hidden=plan.hidden, has_labels=has_labels)
    actor = plan.algorithm.make_policy(spec).to(device)
    found.load({"actor": actor}, spec=spec, device=device)
    return actor


def prepare(
    policy: str | Path | Policy,
    *,
    task: AbstractTask | None = None,
    recognition: Recognition | EllipsisType | None = ...,
    seed: int = 0,
    device: str = "cpu",
) -> tuple[AbstractTask, Recognition | None, Policy]:
    """Return what a policy acts in and with; arguments and errors are those of ``evaluate``.

    Returns:
        The task, which reads the flow labels if there are any; their source, for
        ``make_env(recognition=...)``; and the policy.
    """
    check_device(device)
    if isinstance(policy, Path):
        plan = load_plan(policy)
        task = task or plan.task
        recognition = plan.recognition if recognition is ... else recognition
    if task is None:
        raise ValueError("evaluate: give a task, or the Path of a checkpoint, which brings its own")
    labels = None if recognition is ... else recognition
    act: Any = policy
    if isinstance(policy, Path):  # first whether it fits the task, then whether its classifier does
        act = load_policy(policy, task=task, has_labels=labels is not None, device=device)
    task = task if labels is None else labels.check(task)
    if isinstance(policy, str):
        act = make_baseline(policy, task=task, seed=seed)
    return task, labels, act


@in_own_state
def evaluate(
    policy: str | Path | Policy,
    *,
    task: AbstractTask | None = None,
    recognition: Recognition | EllipsisType | None = ...,
    episodes: int = 32,
    flows: Flows = Flows(),
    seed: int = 0,
    callbacks: Iterable[Callback] = (),
) -> dict[str, Any]:
    """Run one episode from each of the fixed starts.

    Args:
        policy: ``Path`` of a run folder or checkpoint, name of a baseline of the task, or a policy
            that writes ``action``.
        task: the task; by default that of the checkpoint.
        recognition: source of flow labels, see ``make_env``; by default that of the checkpoint's
            run, and None for other policies.
        episodes: number of starts.
        flows: number of flows, and how they are computed; the policy is on their device.
        seed: seed of the starts and of random actions; 0 gives the starts of every run's final
            evaluation, 1 those that selected its best checkpoint.
        callbacks: called during the evaluation, such as ``Progress()``.

    Returns:
        The numbers of ``Episodes.metrics``.

    Raises:
        ValueError: for invalid settings, and checkpoints that do not fit the task.
    """
    called = join(callbacks)
    task, labels, act = prepare(
        policy, task=task, recognition=recognition, seed=seed, device=flows.device
    )
    called.on_phase("compilation" if flows.compile else "set-up")
    env = make_env(
        task=task,
        flows=replace(flows, num_envs=min(flows.num_envs, episodes)),
        seed=seed,
        frames_per_action=task.checks_per_action,  # callbacks may read each
        recognition=labels,
    )
    try:
        called.on_begin(env)
        called.on_phase("evaluation", total=episodes)
        return run_episodes(
            env,
            act,
            fixed_starts(task, episodes, seed=seed),
            on_step=lambda start_of, step: called.on_step(step),
            on_episodes=called.on_progress,
        ).metrics()
    finally:
        called.on_close()
        env.close()
