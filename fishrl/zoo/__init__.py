"""Trained policies that come with the package.

Example::

    from fishrl.envs import make_env
    from fishrl.training import load_plan, load_policy

    policy, plan = load_policy("zoo/gait_sharp"), load_plan("zoo/gait_sharp")
    env = make_env(task=plan.task, recognition=plan.recognition)

``zoo/<name>`` stands for a policy where a run folder or a checkpoint is accepted, and the programs
take ``policy=zoo/<name>``; ``hub:<owner>/<name>`` stands for one of the Hugging Face Hub. Each
folder below this one was written by ``fishrl export-policy``; its ``README.md`` says how the policy
was trained and evaluated.
"""

from importlib.util import find_spec
from pathlib import Path

from fishrl.extras import show_install
from fishrl.settings import suggest

_ROOT = Path(__file__).parent
PREFIX, HUB = "zoo/", "hub:"
#: Files of an exported policy: data and weights, none of which is code.
_FILES = ["*.json", "*.csv", "*.pt", "SHA256SUMS"]


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
    """Return the folder of ``zoo/<name>``, or ``<name>``, unless one is there, or of ``hub:...``.

    Any other is returned as it is.
    """
    if str(path).startswith(HUB):
        return fetch_policy(str(path))
    folder = Path(path).expanduser()
    is_name = str(path).startswith(PREFIX) or str(path) in list_policies()
    return find_policy(str(path)) if is_name and not folder.exists() else folder


def fetch_policy(name: str) -> Path:
    """Return the folder of a policy of the Hugging Face Hub, downloaded unless it is in its cache.

    It is read as any other checkpoint, which runs no code of it. Needs the extra ``hub``.

    Args:
        name: ``hub:<owner>/<name>``, or ``hub:<owner>/<name>@<commit>``.

    Raises:
        OSError: if the hub cannot be reached, or has no such policy.
        ValueError: for an invalid name.
    """
    if find_spec("huggingface_hub") is None:
        raise ImportError(f"{name} needs a package: {show_install('hub')}")
    from huggingface_hub import snapshot_download
    from huggingface_hub.errors import HTTPError

    repository, _, commit = name.removeprefix(HUB).partition("@")
    try:
        found = snapshot_download(repository, revision=commit or None, allow_patterns=_FILES)
    except (HTTPError, OSError) as error:
        raise OSError(f"{name}: {' '.join(str(error).split())}") from error
    return Path(found)
