"""One flow as a ``gymnasium.Env``."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import Env
from gymnasium.vector import AutoresetMode

from fishrl.wrappers.pictures import Array
from fishrl.wrappers.vector import FlowVectorEnv


class FlowSingleEnv(Env[Array, Any]):
    """One flow as a ``gymnasium.Env``.

    Observations are ``[num_stacked * n_obs]``, float32. ``info["action_mask"]`` holds the legal
    actions.

    Args:
        vector: environment with ``num_envs=1`` and ``autoreset_mode="Disabled"``; this wrapper
            closes it.
    """

    def __init__(self, vector: FlowVectorEnv) -> None:
        if vector.num_envs != 1 or vector.autoreset_mode is not AutoresetMode.DISABLED:
            raise ValueError("FlowSingleEnv needs num_envs=1 and autoreset_mode='Disabled'")
        self.vector = vector
        self.observation_space = vector.single_observation_space
        self.action_space = vector.single_action_space
        self.render_mode = vector.render_mode
        self.metadata = {k: v for k, v in vector.metadata.items() if k != "autoreset_mode"}

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Start a new episode; return its first observation and info."""
        super().reset(seed=seed)
        observations, infos = self.vector.reset(seed=seed, options=options)
        return observations[0], _take_first(infos)

    def step(self, action: Any) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Advance the flow by one decision; see ``FlowVectorEnv.step``."""
        observed, reward, terminated, truncated, infos = self.vector.step(np.asarray(action)[None])
        ends = bool(terminated[0]), bool(truncated[0])
        return observed[0], float(reward[0]), *ends, _take_first(infos)

    def action_masks(self) -> Array:
        """Return the currently legal actions, ``[num_actions]`` bool."""
        mask: Array = self.vector.action_masks()[0]
        return mask

    def render(self) -> Any:
        """Return a picture ``[height, width, 3]``, uint8."""
        return self.vector.render()[0]

    def close(self) -> None:
        """Close the environment and its solver."""
        self.vector.close()


def _take_first(infos: Mapping[str, Any]) -> dict[str, Any]:
    """Return the infos of the first row."""
    return {name: values[0] for name, values in infos.items() if not name.startswith("_")}
