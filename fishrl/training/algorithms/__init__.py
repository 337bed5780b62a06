"""Ways to learn, all through the one training loop: the setting ``algorithm``."""

from fishrl.training.algorithms.algorithm import Algorithm, build_algorithm
from fishrl.training.algorithms.discrete_sac import DiscreteSAC
from fishrl.training.algorithms.value_based import DQN, DRQN

__all__ = ["DQN", "DRQN", "Algorithm", "DiscreteSAC", "build_algorithm"]
