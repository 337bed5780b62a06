"""The way in from Stable-Baselines3: flows side by side as its ``VecEnv``.

It needs ``pip install 'fishrl[stable-baselines3]'`` and is imported by its own name:
``from fishrl.envs.stable_baselines import FlowVecEnv``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from torchrl.envs import TransformedEnv

try:
    from stable_baselines3.common.vec_env import VecEnv
except ImportError as error:
    raise ImportError(
        "fishrl.envs.stable_baselines needs Stable-Baselines3: "
        "pip install 'fishrl[stable-baselines3]'"
    ) from error

from fishrl.envs.gymnasium import FlowVectorEnv

Array = np.ndarray[Any, Any]


class FlowVecEnv(VecEnv):
    """An environment of ``make_env`` for Stable-Baselines3; B flows are B rows.

    ``env_method("action_masks")`` gives the legal actions, as ``MaskablePPO`` of sb3-contrib asks
    for them; algorithms without masks fit tasks in which every action is always legal.

    Args:
        env: of ``make_env``; this wrapper takes it over and closes it.
    """

    def __init__(self, env: TransformedEnv) -> None:
        self.vector = FlowVectorEnv(env, autoreset_mode="SameStep")
        super().__init__(
            self.vector.num_envs,
            self.vector.single_observation_space,
            self.vector.single_action_space,
        )
        self._actions: Array = np.zeros(self.num_envs, dtype=np.int64)

    def reset(self) -> Array:
        """Begin new episodes in all rows; ``seed`` before it sets the seed of the starts."""
        observations, infos = self.vector.reset(seed=self._seeds[0])
        self._reset_seeds()
        self._reset_options()
        self.reset_infos = self._split(infos)
        return observations

    def step_async(self, actions: Array) -> None:
        """Keep the actions ``[B]`` for ``step_wait``."""
        self._actions = actions

    def step_wait(self) -> tuple[Array, Array, Array, list[dict[str, Any]]]:
        """Act; return observations ``[B, ...]``, rewards, dones and a dict of infos per row.

        Rows that end begin anew at once; ``terminal_observation`` and ``TimeLimit.truncated`` tell
        the end from the new beginning.
        """
        observations, rewards, terminated, truncated, infos = self.vector.step(self._actions)
        dones = terminated | truncated
        final = infos.pop("final_obs", None)
        last = self._split(infos.pop("final_info", {}))
        rows = self._split(infos)
        for row in range(self.num_envs):
            if dones[row]:
                self.reset_infos[row] = rows[row]
                rows[row] = last[row] | {"terminal_observation": final[row]}
            rows[row]["TimeLimit.truncated"] = bool(truncated[row] and not terminated[row])
        return observations, rewards.astype(np.float32), dones, rows

    def close(self) -> None:
        """End the solver's processes, if any."""
        self.vector.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute, the same for each row; for ``action_masks`` see ``env_method``."""
        value = getattr(self.vector, attr_name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refuse: rows are one environment.

        Raises:
            ValueError: always.
        """
        raise ValueError(
            f"{attr_name} = {value}: rows share one environment; make another with make_env"
        )

    def env_method(
        self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method of the vector environment, and give each row its row of the result."""
        result = getattr(self.vector, method_name)(*method_args, **method_kwargs)
        return [result[row] for row in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """Return False for each row: there are no single environments that could be wrapped."""
        return [False for _ in self._get_indices(indices)]

    def _split(self, infos: dict[str, Any]) -> list[dict[str, Any]]:
        """Turn infos of all rows into one dict per row."""
        names: Sequence[str] = [name for name in infos if not name.startswith("_")]
        return [{name: infos[name][row] for name in names} for row in range(self.num_envs)]
