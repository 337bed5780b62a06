"""The tasks, one file each."""

from fishrl.envs.tasks.follower import Follower
from fishrl.envs.tasks.karman_gait import KarmanGait
from fishrl.envs.tasks.predation import Predation
from fishrl.envs.tasks.predation_pair import PredationPair

__all__ = ["Follower", "KarmanGait", "Predation", "PredationPair"]
