"""Optional packages: the command that installs those of an extra."""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, requires

from packaging.requirements import Requirement


def show_install(extra: str) -> str:
    """Return the command that installs the packages of an extra, for a clone and a wheel alike.

    Args:
        extra: as in ``[project.optional-dependencies]`` of ``pyproject.toml``.
    """
    try:
        wanted = [Requirement(line) for line in requires("fishrl") or ()]
    except PackageNotFoundError:  # a source tree that is on the path, but not installed
        return f"pip install -e '.[{extra}]'"
    needed = [
        f"'{one.name}{one.specifier}'"
        for one in wanted
        if one.name != "fishrl" and one.marker and one.marker.evaluate({"extra": extra})
    ]
    return " ".join(("pip install", *needed))


@contextmanager
def needing(extra: str, what: str) -> Iterator[None]:
    """Raise ImportError with the command that installs an extra if an import inside fails."""
    try:
        yield
    except ImportError as error:
        raise ImportError(f"{what} needs packages: {show_install(extra)}") from error
