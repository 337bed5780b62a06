"""Former names of classes and settings that files of earlier runs may contain."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

_ALGORITHMS = {
    "DiscreteSAC": "fishrl.training.algorithms.discrete_sac.DiscreteSAC",
    "DQN": "fishrl.training.algorithms.dqn.DQN",
    "DRQN": "fishrl.training.algorithms.drqn.DRQN",
}
_FORMER = (
    "experiments.algorithms",
    "experiments.algorithms.discrete_sac",
    "experiments.algorithms.value_based",
    "fishrl.training.algorithms",
)

#: Old dotted name -> new dotted name.
ALIASES: dict[str, str] = {
    **{f"{old}.{name}": new for old in _FORMER for name, new in _ALGORITHMS.items()},
    "experiments.logger.CsvLogger": "fishrl.training.logger.CsvLogger",
    "experiments.logger.WandbLogger": "fishrl.training.logger.WandbLogger",
}

#: The only algorithm, before ``algorithm`` existed, and its settings.
DEFAULT_ALGORITHM = {"_target_": _ALGORITHMS["DiscreteSAC"]}
FORMER_SETTINGS = ("alpha_init", "target_entropy_weight")


def update_config(config: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of a stored run, plain data, under their current names and places."""
    current: dict[str, Any] = update_names(dict(config))
    algorithm = current.get("algorithm") or DEFAULT_ALGORITHM
    moved = {name: current.pop(name) for name in FORMER_SETTINGS if name in current}
    current["algorithm"] = {**algorithm, **moved}
    if "vorticity_limit" in current:
        current["field_limit"] = current.pop("vorticity_limit")
    return current


def update_names(node: Any) -> Any:
    """Return plain nested data with the current name in every ``_target_``."""
    if isinstance(node, list):
        return [update_names(item) for item in node]
    if not isinstance(node, dict):
        return node
    return {
        name: ALIASES.get(value, value)
        if name == "_target_" and isinstance(value, str)
        else update_names(value)
        for name, value in node.items()
    }
