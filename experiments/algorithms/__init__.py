"""Ways to learn, all through the one training loop: the setting ``algorithm``."""

from experiments.algorithms.algorithm import Algorithm, build_algorithm
from experiments.algorithms.discrete_sac import DiscreteSAC
from experiments.algorithms.value_based import DQN, DRQN

__all__ = ["DQN", "DRQN", "Algorithm", "DiscreteSAC", "build_algorithm"]
