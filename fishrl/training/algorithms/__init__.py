"""Algorithms, all trained by the one loop."""

from fishrl.training.algorithms.algorithm import Algorithm
from fishrl.training.algorithms.discrete_sac import DiscreteSAC
from fishrl.training.algorithms.dqn import DQN
from fishrl.training.algorithms.drqn import DRQN
from fishrl.training.algorithms.ppo import PPO
from fishrl.training.algorithms.sac import SAC

__all__ = ["DQN", "DRQN", "PPO", "SAC", "Algorithm", "DiscreteSAC"]
