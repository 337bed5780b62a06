"""Construction of an environment with the transforms that policies need."""

from collections.abc import Callable, Sequence
from secrets import randbits
from typing import Any

from tensordict import TensorDictBase
from torchrl.envs import (
    ActionMask,
    CatFrames,
    InitTracker,
    RewardSum,
    StepCounter,
    Transform,
    TransformedEnv,
)

from fishrl.envs.agents import name_entry
from fishrl.envs.flow_env import FlowEnv
from fishrl.envs.flows import Flows
from fishrl.envs.recognition import Recognition
from fishrl.envs.task import AbstractTask
from fishrl.presets import merge, read_task
from fishrl.settings import build, checked
from fishrl.torch_state import in_own_state


class StableEnv(TransformedEnv):
    """TorchRL's environment with transforms, which torch's global state does not affect."""

    @in_own_state
    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDictBase:
        return super()._reset(tensordict, **kwargs)

    def any_done(self, tensordict: TensorDictBase) -> bool:
        """Return whether any row is done, as TorchRL, which reads it twice."""
        done = tensordict["done"]
        is_any = bool(done.any())
        if is_any:
            tensordict["_reset"] = done.clone()
        return is_any

    @in_own_state
    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        return super()._step(tensordict)


def make_task(name: str, **changes: Any) -> AbstractTask:
    """Return the task of a name, as ``task=<name>`` or ``preset=<name>`` on the command line.

    Args:
        name: such as ``karman_gait`` or, for the task of a preset, ``gait_bend``; see
            ``fishrl.presets.list_tasks``.
        **changes: settings of the task, objects or plain data: ``body_length=48``,
            ``stream={"num_phases": 4}``.

    Raises:
        ValueError: for an unknown name, with the nearest one, and for invalid settings.
    """
    return build(AbstractTask, merge(read_task(name), changes, replaces=True))


@checked
@in_own_state
def make_env(
    *,
    task: AbstractTask | str,
    flows: Flows,
    seed: int | None = None,
    starts: TensorDictBase | None = None,
    frames_per_action: int = 1,
    on_frame: Callable[[FlowEnv], None] | None = None,
    recognition: Recognition | None = None,
    transforms: Sequence[Transform] = (),
) -> TransformedEnv:
    """Return a ``FlowEnv`` with the transforms that policies need; see ``FlowEnv`` for arguments.

    Adds ``observation_stack`` ``[B, num_stacked * n_obs]`` (oldest first, filled with the first
    observation at reset), ``is_init``, ``step_count`` and ``episode_reward``, and for a task with
    ``critic_senses`` a ``critic_stack`` of these. Episodes are truncated after ``task.time_limit``
    decisions. Random discrete actions respect the action mask; continuous actions have none. With
    several fish per flow, stacks, masks and ``episode_reward`` are per fish, under ``agents``.

    Without ``seed`` it draws its own, ``env.base_env.seed``, so that several environments differ;
    ``env.set_seed`` repeats episodes.

    ``task`` may be a name, see ``make_task``. ``recognition`` is the source of flow labels, such as
    ``Oracle()``. Further ``transforms`` are inserted before the frame stack and may lengthen
    ``observation``.

    Raises:
        ValueError: for invalid arguments.
    """
    if isinstance(task, str):
        task = make_task(task)
    if recognition is not None:
        task = recognition.check(task)

    def stack(num: int, name: str, stacked: str) -> CatFrames:
        own, to = name_entry(task, name), name_entry(task, stacked)
        return CatFrames(N=num, dim=-1, in_keys=[own], out_keys=[to])

    env = StableEnv(
        FlowEnv(
            task=task,
            flows=flows,
            seed=randbits(32) if seed is None else seed,
            starts=starts,
            frames_per_action=frames_per_action,
            on_frame=on_frame,
        )
    )
    for transform in (
        InitTracker(),
        StepCounter(max_steps=task.time_limit),
        RewardSum(),
        *(recognition.transforms(task) if recognition is not None else ()),
        *transforms,
        stack(task.num_stacked, "observation", "observation_stack"),
    ):
        env.append_transform(transform)
    if task.critic_senses:
        env.append_transform(stack(task.critic_num_stacked, "critic_observation", "critic_stack"))
    if task.action_bounds is None:
        action, mask = name_entry(task, "action"), name_entry(task, "action_mask")
        env.append_transform(ActionMask(action, mask))
    return env
