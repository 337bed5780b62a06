"""Reinforcement learning of swimming in a simulated flow.

``fishrl.physics``: flow solver and bodies. ``fishrl.envs``: the TorchRL environment and its tasks.
``fishrl.modules`` and ``fishrl.objectives``: networks and losses. ``fishrl.training``: the training
loop, algorithms and evaluation. ``fishrl.viewer``: scenes, recordings and live views in rerun.
"""

__version__ = "0.3.0"
