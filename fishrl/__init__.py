"""Fish that learn to swim in a real flow.

``fishrl.physics`` is the flow and the body, ``fishrl.envs`` the TorchRL environment and its tasks,
``fishrl.modules`` and ``fishrl.objectives`` the brain, ``fishrl.viewer`` the way to rerun.
"""

__version__ = "0.1.0"
