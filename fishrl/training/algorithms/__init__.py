"""Algorithms, one per module, all trained by the same loop; see ``algorithm`` to add one."""

from fishrl.training.algorithms.algorithm import Algorithm

__all__ = ["Algorithm"]
