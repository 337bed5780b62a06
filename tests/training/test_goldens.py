"""The same seed gives the same learning curve as the version that wrote ``tests/goldens``.

After a change that moves the curves on purpose, write them anew by
``REMAKE_GOLDENS=1 python -m pytest tests/training/test_goldens.py``.
"""

import csv
import os
from pathlib import Path

import pytest

from fishrl.training import Algorithm, DiscreteSAC
from fishrl.training.algorithms.dqn import DQN
from fishrl.training.algorithms.drqn import DRQN
from fishrl.training.algorithms.ppo import PPO
from fishrl.training.algorithms.sac import SAC
from tests.training.conftest import Toy, read_rows

GOLDENS = Path(__file__).parents[1] / "goldens"
ALGORITHMS: dict[str, Algorithm] = {
    "discrete_sac": DiscreteSAC(),
    "dqn": DQN(epsilon_frames=60),
    "double_dqn": DQN(is_double=True, epsilon_frames=60),
    "drqn": DRQN(sequence_length=4, epsilon_frames=60),
    "sac": SAC(),
    "ppo": PPO(rollout_length=8),
}


def read(folder: Path, name: str = "metrics.csv") -> list[dict[str, float]]:
    """Return the rows of a metrics file without what depends on the machine; NaN where empty."""
    return [{k: float(v or "nan") for k, v in row.items()} for row in read_rows(folder, name)]


def write(path: Path, rows: list[dict[str, str]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, rows[0].keys(), lineterminator="\n")
        table.writeheader()
        table.writerows(rows)


@pytest.mark.parametrize("name", ALGORITHMS)
def test_seed_reproduces_the_golden_learning_curve(name: str, toy: Toy) -> None:
    algorithm = ALGORITHMS[name]
    task = {"is_continuous": not algorithm.takes_discrete}
    toy.begin(algorithm=algorithm, task=task, name=name, baselines=(), final_episodes=1).run()
    if "REMAKE_GOLDENS" in os.environ:
        write(GOLDENS / f"toy_{name}.csv", read_rows(toy.folder / name))
    rows, expected = read(toy.folder / name), read(GOLDENS, f"toy_{name}.csv")
    assert len(rows) == len(expected)
    for row, golden in zip(rows, expected, strict=True):
        # 1e-5: float32 sums may be ordered differently on another processor
        assert row == pytest.approx(golden, rel=1e-5, abs=1e-7, nan_ok=True)
