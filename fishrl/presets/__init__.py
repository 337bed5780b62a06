"""Tasks and bundles of settings by name: YAML files, and what reads them."""

from fishrl.presets.reading import (
    GROUPS,
    REPLACED,
    find_replacement,
    list_names,
    list_tasks,
    merge,
    read_file,
    read_task,
)

__all__ = [
    "GROUPS",
    "REPLACED",
    "find_replacement",
    "list_names",
    "list_tasks",
    "merge",
    "read_file",
    "read_task",
]
