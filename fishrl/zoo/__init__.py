"""Trained policies that come with the package.

Example::

    from fishrl.envs import make_env
    from fishrl.training import load_plan, load_policy

    policy, plan = load_policy("zoo/gait_sharp"), load_plan("zoo/gait_sharp")
    env = make_env(task=plan.task, recognition=plan.recognition)

``zoo/<name>`` stands for a policy where a run folder or a checkpoint is accepted, and the programs
take ``policy=zoo/<name>``. Each folder below this one was written by ``fishrl export-policy``; its
``README.md`` says how the policy was trained and evaluated.
"""

from pathlib import Path

from fishrl.settings import suggest

_ROOT = Path(__file__).parent
PREFIX = "zoo/"


def list_policies() -> list[str]:
    """List the names of the policies."""
    return sorted(path.parent.name for path in _ROOT.glob("*/manifest.json"))


def find_policy(name: str) -> Path:
    """Return the folder of a policy, which is a checkpoint.

    Args:
        name: such as ``gait_sharp`` or ``zoo/gait_sharp``.

    Raises:
        ValueError: if there is none of that name.
    """
    known, wanted = list_policies(), name.removeprefix(PREFIX)
    if wanted not in known:
        hint = suggest(wanted, known) or f"; there is: {', '.join(known)}"
        raise ValueError(f"{PREFIX}{wanted}: there is no such policy{hint}")
    return _ROOT / wanted


def find_folder(path: str | Path) -> Path:
    """Return the folder of ``zoo/<name>``, unless there is one of that path; any other as it is."""
    folder = Path(path).expanduser()
    is_name = str(path).startswith(PREFIX) and not folder.exists()
    return find_policy(str(path)) if is_name else folder
