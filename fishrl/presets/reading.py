"""Read YAML files by name, as plain data, for Python as for the command line.

The files of ``task`` say what deviates from the defaults of a class, those of ``preset`` bundle
settings of a task and of its training. Their ``defaults`` name files of the same folder on which
they build and, in ``override /task``, the task; ``fishrl.programs`` gives hydra what is read here.
"""

from collections.abc import Mapping
from copy import deepcopy
from functools import cache
from pathlib import Path
from typing import Any

import yaml

from fishrl.settings import TARGET, unknown

GROUPS = ("task", "preset")
DEFAULT_TASK = "predation"  # of presets that name none

Node = dict[str, Any]
#: In C where it is there, ten times as fast.
_Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def list_names(group: str) -> list[str]:
    """List the names in a group, ``task`` or ``preset``."""
    return sorted(path.stem for path in (Path(__file__).parent / group).glob("*.yaml"))


def list_tasks() -> list[str]:
    """List the names that ``read_task`` takes: all of both groups."""
    return sorted(name for group in GROUPS for name in list_names(group))


def read_task(name: str) -> Node:
    """Return the settings of a task or, for the name of a preset, those of its task.

    Raises:
        ValueError: for an unknown name, with the nearest one.
    """
    if name not in (known := list_tasks()):
        raise unknown(name, known)
    if name in list_names("task"):
        return read_file("task", name)[1]
    task, node = read_file("preset", name)
    return merge(read_file("task", task or DEFAULT_TASK)[1], node.get("task", {}))


def read_file(group: str, name: str) -> tuple[str | None, Node]:
    """Return the task that a file chooses, if any, and what it and those below it say."""
    task: str | None = None
    whole: Node = {}
    node = deepcopy(_parse(group, name))
    for entry in node.pop("defaults", ()):
        if isinstance(entry, Mapping):
            task = entry["override /task"]
        elif entry != "_self_":
            below, base = read_file(group, entry)
            task, whole = task or below, merge(whole, base)
    return task, merge(whole, node)


def merge(node: Node, other: Mapping[str, Any], *, replaces: bool = False) -> Node:
    """Change nested data in place, and return it.

    Args:
        node: the data.
        other: takes precedence; lists, and where ``replaces`` objects with a ``_target_``, replace
            what is there.
        replaces: see ``other``; not in files, in which an object's ``_target_`` may stand below.
    """
    for name, value in other.items():
        is_nested = isinstance(value, Mapping) and isinstance(node.get(name), dict)
        is_whole = replaces and is_nested and TARGET in value
        node[name] = merge(node[name], value) if is_nested and not is_whole else value
    return node


@cache
def _parse(group: str, name: str) -> Node:
    path = Path(__file__).parent / group / f"{name}.yaml"
    node: Node = yaml.load(path.read_text(encoding="utf-8"), Loader=_Loader)
    return node
