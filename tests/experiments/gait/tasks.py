"""The smallest Kármán gait, for tests."""

from typing import Any

from fishrl.envs import KarmanGait
from tests.envs.conftest import SMALL

#: The same for a command line.
OVERRIDES = [f"task.{name}={value}" for name, value in {**SMALL, "wall_margin_bl": 0.25}.items()]
#: Duration of a trial, T.
BRIEF = 2.9


def make_task(**arguments: Any) -> KarmanGait:
    return KarmanGait(**{**SMALL, "wall_margin_bl": 0.25, "time_limit": 12, **arguments})
