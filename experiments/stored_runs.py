"""Settings that a stored run adds to a command line."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fishrl.training.checkpoint import read_metadata
from fishrl.training.classifier import find_classifier


def read_task(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return task and recognition of the ``run`` or ``checkpoint`` that is given.

    The task is left out where the command line names a task or a preset.

    Args:
        given: settings of the command line.

    Raises:
        ValueError: if there is no checkpoint.
    """
    source = given.get("run") or given.get("checkpoint")
    if source is None:
        return {}
    path, metadata = read_metadata(str(source))
    trained = metadata["config"]
    found = {"recognition": find_classifier(trained.get("recognition"), path)}
    if not {"task", "preset"} & set(given):
        found |= {"task": trained["task"], "preset": trained["preset"]}
    return found
