"""Load learned policies from checkpoints, and evaluate policies."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from types import EllipsisType
from typing import Any

import torch
from pydantic import NonNegativeInt, PositiveInt
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import TransformedEnv

from fishrl.envs import AbstractTask, Flows, Recognition, make_env
from fishrl.envs.episodes import Policy, run_episodes
from fishrl.physics.fast.checks import check_device
from fishrl.settings import checked
from fishrl.torch_state import in_own_state
from fishrl.training.baselines import make_baseline
from fishrl.training.callback import SILENT, Callback, join
from fishrl.training.checkpoint import Checkpoint
from fishrl.training.evaluation import fixed_starts
from fishrl.training.plan import Plan
from fishrl.training.policy_spec import PolicySpec, check_senses
from fishrl.zoo import PREFIX, list_policies


@checked
def load_plan(checkpoint: str | Path) -> Plan:
    """Return the settings of a run: its task and recognition, for ``make_env``, and all others.

    Args:
        checkpoint: run folder, checkpoint, ``zoo/<name>`` for a policy of ``fishrl.zoo``, or
            ``hub:<owner>/<name>`` for one that ``fishrl export-policy`` has uploaded.

    Errors are those of ``Plan.from_config`` and ``Checkpoint.find``.
    """
    return Plan.from_config(Checkpoint.find(checkpoint).config)


@checked
@in_own_state
def load_policy(
    checkpoint: str | Path,
    *,
    task: AbstractTask | None = None,
    has_labels: bool | None = None,
    device: str = "cpu",
) -> TensorDictModuleBase:
    """Load a learned policy.

    It samples its actions, but those of DQN and DRQN are greedy. Under
    ``torchrl.envs.set_exploration_type`` with ``ExplorationType.DETERMINISTIC``, as in evaluations,
    it takes the most probable ones.

    Args:
        checkpoint: as in ``load_plan``.
        task: the task to act in; by default the task of its run.
        has_labels: whether transforms label the flows of the task; by default as in its run.
        device: device of the policy.

    Errors are those of ``load_plan``.
    """
    check_device(device)
    found = Checkpoint.find(checkpoint)
    plan = Plan.from_config(found.config)
    if has_labels is None:
        has_labels = plan.recognition is not None
    task = task or plan.task
    spec = PolicySpec.for_task(task, hidden=plan.hidden, has_labels=has_labels)
    with torch.random.fork_rng(devices=[]):  # for weights that are replaced
        actor = plan.algorithm.make_policy(spec).to(device)
    found.load({"actor": actor}, spec=spec, device=device)
    check_senses(task, plan.task, policy=checkpoint)
    return actor


def is_learned(policy: object) -> bool:
    """Return whether a policy is learned: named by a path, ``zoo/<name>``, ``hub:...``."""
    return isinstance(policy, Path) or (isinstance(policy, str) and "/" in policy)


def prepare(
    policy: str | Path | Policy,
    *,
    task: AbstractTask | None = None,
    recognition: Recognition | EllipsisType | None = ...,
    flows: Flows = Flows(),
    seed: int = 0,
    callback: Callback = SILENT,
) -> tuple[TransformedEnv, Policy]:
    """Make an environment that callbacks may read at every check, and the policy to act in it.

    Arguments and errors are those of ``evaluate``.
    """
    check_device(flows.device)
    act: Any = policy
    if isinstance(policy, str | Path) and is_learned(policy):
        plan = load_plan(policy)
        task = task or plan.task
        labels = plan.recognition if recognition is ... else recognition
        # first whether it fits the task, then whether its classifier does
        act = load_policy(policy, task=task, has_labels=labels is not None, device=flows.device)
    else:
        labels = None if recognition is ... else recognition
    if task is None:
        raise ValueError("evaluate: give a task, or the path of a checkpoint, which brings its own")
    task = task if labels is None else labels.check(task)
    if act in list_policies():
        raise ValueError(f"policy = {act}: no baseline; did you mean {PREFIX}{act}?")
    if isinstance(act, str):
        act = make_baseline(act, task=task, seed=seed)
    callback.on_phase("compilation" if flows.compile else "set-up")
    env = make_env(
        task=task,
        flows=flows,
        seed=seed,
        frames_per_action=task.checks_per_action,
        recognition=labels,
    )
    return env, act


@checked
@in_own_state
def evaluate(
    policy: str | Path | Policy,
    *,
    task: AbstractTask | None = None,
    recognition: Recognition | EllipsisType | None = ...,
    episodes: PositiveInt = 32,
    flows: Flows = Flows(),
    seed: NonNegativeInt = 0,
    callbacks: Iterable[Callback] = (),
) -> dict[str, Any]:
    """Run one episode from each of the fixed starts.

    Args:
        policy: run folder or checkpoint of a learned policy, a path with a slash, or
            ``zoo/<name>``; name of a baseline of the task; or a policy that writes ``action``.
        task: the task; by default the checkpoint's.
        recognition: source of flow labels, see ``make_env``; by default the one of the
            checkpoint's run, and None for other policies.
        episodes: number of starts.
        flows: flows that advance together, at most one per episode, and how they are computed; the
            policy is on their device.
        seed: seed of the starts and of random actions; 0 gives the starts of every run's final
            evaluation, 1 those that selected its best checkpoint.
        callbacks: called during the evaluation, such as ``Progress()``.

    Returns:
        The numbers of ``Episodes.metrics``.

    Raises:
        ValueError: for invalid settings, and checkpoints that do not fit the task.
    """
    called = join(callbacks)
    env, act = prepare(
        policy,
        task=task,
        recognition=recognition,
        flows=replace(flows, num_envs=min(flows.num_envs, episodes)),
        seed=seed,
        callback=called,
    )
    try:
        called.on_begin(env)
        called.on_phase("evaluation", total=episodes)
        return run_episodes(
            env,
            act,
            fixed_starts(env.base_env.task, episodes, seed=seed),
            on_step=lambda start_of, step: called.on_step(step),
            on_episodes=called.on_progress,
        ).metrics()
    finally:
        called.on_close()
        env.close()
