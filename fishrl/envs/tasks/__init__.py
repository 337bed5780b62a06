"""The tasks, one file each."""

from fishrl.envs.tasks.karman_gait import KarmanGait
from fishrl.envs.tasks.predation import Predation

__all__ = ["KarmanGait", "Predation"]
