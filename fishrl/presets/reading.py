"""Read YAML files by name, as plain data, for Python as for the command line.

The files of ``task`` say what deviates from the defaults of a class, those of ``preset`` bundle
settings of a task and of its training. Their ``defaults`` name files of the same folder on which
they build and, in ``override /task``, the task; ``fishrl.programs`` gives hydra what is read here.
"""

from collections.abc import Mapping, Sequence
from copy import deepcopy
from functools import cache
from pathlib import Path
from typing import Any

import yaml

from fishrl.settings import TARGET, unknown

GROUPS = ("task", "preset")
DEFAULT_TASK = "predation"  # of presets that name none
_FOLLOWER = (
    "task=follower algorithm=sac task.domain_bl=[5.5,2.5] task.range_bl=[0.5,2.5] "
    "task.time_limit=80 batch_size=128 buffer_size=50000 total_frames=6000 warmup_frames=640 "
    "updates_per_frame=2.0 checkpoint_frames=1000 eval_frames=6000 eval_episodes=4 "
    "final_episodes=16"
)
#: Presets of earlier versions, and what says the same on a command line.
REPLACED = {
    "small": "task.body_length=50 task.levels=1",
    "follower_small": _FOLLOWER,
    "gait_half": "preset=gait_small task.body_length=64",
    "gait_narrow": (
        "preset=gait_small task.body_length=64 task.max_wall_speed=0.1101 task.control.rows="
        "[[0.432,0.486,0.54,0.594,0.648],[0.533,0.599,0.666,0.733,0.799],"
        "[0.62,0.7,0.776,0.855,0.93]]"
    ),
    "gait_paper": "preset=gait_small task.body_length=100 task.skin=immersed-boundary",
    "gait_varied": (
        "preset=gait_small task=karman_varied task.start_flows=[0,1,2,3,4,5,6,7,8,9,10,11] "
        "task.start_x_bl=[1.0,3.5] task.start_y_bl=[-0.6,0.6]"
    ),
}

Node = dict[str, Any]
#: In C where it is there, ten times as fast.
_Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def list_names(group: str) -> list[str]:
    """List the names in a group, ``task`` or ``preset``."""
    return sorted(path.stem for path in (Path(__file__).parent / group).glob("*.yaml"))


def list_tasks() -> list[str]:
    """List the names that ``read_task`` takes: all of both groups."""
    return sorted(name for group in GROUPS for name in list_names(group))


def find_replacement(name: str, known: Sequence[str]) -> ValueError:
    """Return the error for an unknown name, with what replaces it or the nearest known one."""
    if name in REPLACED:
        return ValueError(f"there is no preset '{name}' any more; give {REPLACED[name]}")
    for group in GROUPS:
        if name in list_names(group):
            return ValueError(f"'{name}' is a {group}: give {group}={name}.")
    return unknown(name, known)


def read_task(name: str) -> Node:
    """Return the settings of a task or, for the name of a preset, those of its task.

    Raises:
        ValueError: for an unknown name, with the nearest one.
    """
    if name not in (known := list_tasks()):
        raise find_replacement(name, known)
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
        merges = is_nested and not is_whole
        node[name] = merge(node[name], value, replaces=replaces) if merges else value
    return node


@cache
def _parse(group: str, name: str) -> Node:
    path = Path(__file__).parent / group / f"{name}.yaml"
    node: Node = yaml.load(path.read_text(encoding="utf-8"), Loader=_Loader)
    return node
