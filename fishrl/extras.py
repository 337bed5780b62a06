"""Optional packages: the command that installs those of an extra."""

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
