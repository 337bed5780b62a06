"""Trained policies that come with the package.

Example::

    from fishrl.envs import make_env
    from fishrl.training import load_plan, load_policy

    policy, plan = load_policy("zoo/gait_sharp"), load_plan("zoo/gait_sharp")
    env = make_env(task=plan.task, recognition=plan.recognition, num_envs=3)

``zoo/<name>`` stands for a policy where a run folder or a checkpoint is accepted, and the programs
take ``policy=zoo/<name>``; ``list_policies()`` returns the names. Each folder below this one was
written by ``fishrl export-policy``; its ``README.md`` says how the policy was trained and
evaluated.
"""

from fishrl.training.policy_zoo import find_policy, list_policies

__all__ = ["find_policy", "list_policies"]
