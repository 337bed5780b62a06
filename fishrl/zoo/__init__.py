"""Trained policies that come with the package.

Example::

    from fishrl.envs import make_env, run_episodes
    from fishrl.zoo import load_policy, load_recognition

    policy, task = load_policy("gait_small")
    env = make_env(task=task, recognition=load_recognition("gait_small"), num_envs=3)

Programs take them as ``policy=zoo/gait_small``. Each folder below this one is a policy written by
``python -m experiments.export_policy``; its ``README.md`` says how it was trained and evaluated.
"""

from pathlib import Path

from tensordict.nn import TensorDictModuleBase

from fishrl.bounds import suggest
from fishrl.envs import AbstractTask
from fishrl.training.classifier import Recognition
from fishrl.training.classifier import load_recognition as read_recognition
from fishrl.training.policies import load_plan
from fishrl.training.policies import load_policy as read_policy

_ROOT = Path(__file__).parent
PREFIX = "zoo/"


def list_policies() -> list[str]:
    """List the names of the policies."""
    return sorted(path.parent.name for path in _ROOT.glob("*/manifest.json"))


def find_policy(name: str) -> Path:
    """Return the folder of a policy.

    Args:
        name: such as ``gait_small`` or ``zoo/gait_small``.

    Raises:
        ValueError: if there is none of that name.
    """
    known, wanted = list_policies(), name.removeprefix(PREFIX)
    if wanted not in known:
        raise ValueError(f"{PREFIX}{wanted}: there is no such policy{suggest(wanted, known)}")
    return _ROOT / wanted


def load_policy(name: str, *, device: str = "cpu") -> tuple[TensorDictModuleBase, AbstractTask]:
    """Load a policy and the task that it was trained for.

    Args:
        name: see ``find_policy``.
        device: of the policy.

    Raises:
        ValueError: if there is none of that name.
    """
    folder = find_policy(name)
    return read_policy(folder, device=device), load_plan(folder)[1].task


def load_recognition(name: str) -> Recognition:
    """Load what labels the flows for a policy: None, ``oracle`` or a classifier.

    Args:
        name: see ``find_policy``.

    Raises:
        ValueError: if there is none of that name.
    """
    path, plan = load_plan(find_policy(name))
    return read_recognition(plan.recognition, path)
