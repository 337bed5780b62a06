"""Trained policies that come with the package.

Example::

    from fishrl.envs import make_env
    from fishrl.zoo import load_policy, load_recognition

    policy, task = load_policy("gait_sharp")
    recognition = load_recognition("gait_sharp")
    env = make_env(task=task, recognition=recognition, num_envs=3)

Wherever a run folder or a checkpoint is accepted, ``zoo/gait_sharp`` names one of them, and the
programs take ``policy=zoo/gait_sharp``. Each folder below this one was written by
``fishrl export-policy``; its ``README.md`` says how the policy was trained and
evaluated.
"""

from tensordict.nn import TensorDictModuleBase

from fishrl.envs import AbstractTask
from fishrl.training.classifier import Recognition
from fishrl.training.classifier import load_recognition as read_recognition
from fishrl.training.policies import load_plan
from fishrl.training.policies import load_policy as read_policy
from fishrl.training.policy_zoo import find_policy, list_policies

__all__ = ["find_policy", "list_policies", "load_policy", "load_recognition"]


def load_policy(name: str, *, device: str = "cpu") -> tuple[TensorDictModuleBase, AbstractTask]:
    """Load a policy and the task that it was trained for.

    The policy samples its actions. Under ``torchrl.envs.set_exploration_type`` with
    ``ExplorationType.DETERMINISTIC``, as in evaluations, it takes the most probable ones.

    Args:
        name: such as ``gait_sharp``, one of ``list_policies()``.
        device: of the policy.

    Raises:
        ValueError: if there is none of that name.
    """
    folder = find_policy(name)
    return read_policy(folder, device=device), load_plan(folder)[1].task


def load_recognition(name: str) -> Recognition:
    """Load what labels the flows for a policy: None, ``oracle`` or a classifier.

    Args:
        name: see ``load_policy``.

    Raises:
        ValueError: if there is none of that name.
    """
    path, plan = load_plan(find_policy(name))
    return read_recognition(plan.recognition, path)
