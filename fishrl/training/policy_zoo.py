"""Where the trained policies lie that come with the package, see ``fishrl.zoo``."""

from pathlib import Path

from fishrl.settings import suggest

_ROOT = Path(__file__).parents[1] / "zoo"
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
