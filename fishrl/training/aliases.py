"""Former names of classes that files of earlier runs may contain."""

from __future__ import annotations

_ALGORITHMS = "fishrl.training.algorithms"
_FORMER = ("experiments.algorithms", "experiments.algorithms.value_based")

#: Old dotted name -> new dotted name.
ALIASES: dict[str, str] = {
    "experiments.algorithms.DiscreteSAC": f"{_ALGORITHMS}.DiscreteSAC",
    "experiments.algorithms.discrete_sac.DiscreteSAC": f"{_ALGORITHMS}.DiscreteSAC",
    **{f"{old}.{name}": f"{_ALGORITHMS}.{name}" for old in _FORMER for name in ("DQN", "DRQN")},
    "experiments.logger.CsvLogger": "fishrl.training.logger.CsvLogger",
    "experiments.logger.WandbLogger": "fishrl.training.logger.WandbLogger",
}
