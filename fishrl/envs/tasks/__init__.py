"""The tasks, one file each."""

from fishrl.envs.tasks.predation import Predation

__all__ = ["Predation"]
