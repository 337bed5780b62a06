"""A ``VecEnv`` of flows for Stable-Baselines3; needs the extra ``stable-baselines3``."""

from typing import Any

import numpy as np
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import ExplorationType, TransformedEnv, set_exploration_type

from fishrl.extras import needing

with needing("stable-baselines3", __name__):
    from stable_baselines3.common.vec_env import VecEnv

from fishrl.wrappers.pictures import Array
from fishrl.wrappers.vector import FlowVectorEnv


class FlowVecEnv(VecEnv):
    """Wrap an environment of ``make_env`` with B flows as a ``VecEnv`` of B rows.

    ``env_method("action_masks")`` returns the legal actions, as ``MaskablePPO`` of sb3-contrib
    expects. Algorithms without masks need tasks whose actions are continuous or always legal.

    Args:
        env: an environment of ``make_env``; this wrapper closes it.
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
        """Start new episodes in all rows, with the seed given to ``seed``, if any.

        Raises:
            ValueError: if options are set.
        """
        if any(self._options):
            raise ValueError(f"options = {self._options}: must be empty")
        observations, infos = self.vector.reset(seed=self._seeds[0])
        self._reset_seeds()
        self._reset_options()
        self.reset_infos = self._split(infos)
        return observations

    def step_async(self, actions: Array) -> None:
        """Store the actions ``[B]`` for ``step_wait``."""
        self._actions = actions

    def step_wait(self) -> tuple[Array, Array, Array, list[dict[str, Any]]]:
        """Return observations ``[B, ...]``, rewards, dones and a dict of infos per row.

        Ended rows are reset at once; their infos hold ``terminal_observation`` and
        ``TimeLimit.truncated``.
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
        """Close the environment and its solver."""
        self.vector.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute, which is the same for all rows."""
        value = getattr(self.vector, attr_name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Raise ValueError: all rows share one environment."""
        raise ValueError(
            f"{attr_name} = {value}: all rows share one environment; make another with make_env"
        )

    def env_method(
        self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method of the vector environment and return its rows."""
        result = getattr(self.vector, method_name)(*method_args, **method_kwargs)
        return [result[row] for row in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """Return False for each row: there are no individual environments."""
        return [False for _ in self._get_indices(indices)]

    def _split(self, infos: dict[str, Any]) -> list[dict[str, Any]]:
        """Turn infos of all rows into one dict per row."""
        values = {name: value for name, value in infos.items() if not name.startswith("_")}
        return [{k: value[row] for k, value in values.items()} for row in range(self.num_envs)]


class Learned:
    """A policy of fishrl with ``predict``, for Stable-Baselines3's ``evaluate_policy``.

    Args:
        policy: of ``fishrl.training.load_policy``, without a memory of its own.
        envs: the flows in which it acts, for the legal actions.
    """

    def __init__(self, policy: TensorDictModuleBase, envs: FlowVecEnv) -> None:
        self.policy, self.envs = policy, envs

    def predict(
        self,
        observation: Array,
        state: None = None,
        episode_start: Array | None = None,
        deterministic: bool = True,
    ) -> tuple[Array, None]:
        """Return the actions for the present observations ``[B, n]`` of all flows, and no state."""
        seen = {"observation_stack": torch.as_tensor(observation)}
        if not self.envs.vector.is_continuous:
            seen["action_mask"] = torch.as_tensor(self.envs.vector.action_masks())
        kind = ExplorationType.DETERMINISTIC if deterministic else ExplorationType.RANDOM
        with torch.no_grad(), set_exploration_type(kind):
            action = self.policy(TensorDict(seen, [len(observation)]))["action"]
        return action.numpy(), None
