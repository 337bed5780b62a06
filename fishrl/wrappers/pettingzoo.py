"""Several fish as a PettingZoo environment; needs the extra ``pettingzoo``."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from torchrl.envs import TransformedEnv

from fishrl.envs.agents import AGENTS
from fishrl.envs.episodes import name_terms
from fishrl.extras import needing
from fishrl.wrappers.pictures import Array, Pictures

with needing("pettingzoo", __name__):
    from pettingzoo import ParallelEnv

    from fishrl.wrappers.spaces import make_spaces


class FlowParallelEnv(ParallelEnv[str, Array, Any]):
    """Wrap one flow with several fish, ``fish_0`` etc., as a ``pettingzoo.ParallelEnv``.

    Observations are ``observation_stack`` ``[num_stacked * n_obs]``, float32; actions are integers
    or, if continuous, numbers ``[num_actions]`` in [-1, 1]. ``infos`` holds the ``action_mask`` of
    discrete actions and the reports of environment and task. An episode ends for all fish at once.

    Args:
        env: an environment of ``make_env`` with one flow of several fish; this wrapper closes it.
        render_mode: ``rgb_array`` for pictures from ``render``, or None.
        field: the field that is drawn: vorticity, pressure or speed.
    """

    def __init__(
        self, env: TransformedEnv, *, render_mode: str | None = None, field: str = "vorticity"
    ) -> None:
        task = env.base_env.task
        if task.num_fish == 1:
            raise ValueError(
                f"{type(task).__name__} has one fish, and FlowParallelEnv wraps several: use "
                "fishrl.wrappers.gymnasium"
            )
        if env.batch_size != (1,):
            raise ValueError(
                f"FlowParallelEnv wraps one flow, not {env.batch_size[0]}: flows=Flows(num_envs=1)"
            )
        self.env = env
        self.render_mode = render_mode
        self.metadata = {
            "name": f"fishrl_{type(task).__name__.lower()}",
            "render_modes": ["rgb_array"],
            "render_fps": 8,
        }
        self._pictures = Pictures(env, render_mode=render_mode, field=field)
        self.possible_agents: list[str] = list(env.group_map[AGENTS])
        self.agents: list[str] = []
        self.is_continuous = task.action_bounds is not None
        spaces = {name: make_spaces(env) for name in self.possible_agents}
        self.observation_spaces = {name: seen for name, (seen, _) in spaces.items()}
        self.action_spaces = {name: acts for name, (_, acts) in spaces.items()}

    def observation_space(self, agent: str) -> Any:
        """Return the space of a fish's observations."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Any:
        """Return the space of a fish's actions."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Array], dict[str, dict[str, Any]]]:
        """Start a new episode; return observations and infos by fish, with the ``seed``."""
        if seed is not None:
            self.env.set_seed(int(seed), static_seed=True)
        self.agents = list(self.possible_agents)
        self._pictures.begin(np.ones(1, dtype=np.bool_))
        self._state: TensorDictBase = self.env.reset()
        infos, own = self._tell(), np.asarray(self.env.base_env.seed)
        return self._observe(), {name: info | {"seed": own} for name, info in infos.items()}

    def step(
        self, actions: Mapping[str, Any]
    ) -> tuple[
        dict[str, Array],
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, dict[str, Any]],
    ]:
        """Advance the flow by one decision of all fish.

        Returns observations, rewards, terminations, truncations and infos by fish.

        Raises:
            ValueError: for illegal or missing actions, and after the end of the episode.
        """
        if not self.agents or set(actions) != set(self.agents):
            raise ValueError(
                f"actions of {sorted(actions)}: expected {self.agents}; reset() first?"
            )
        chosen = torch.as_tensor(
            np.stack([np.asarray(actions[name]) for name in self.agents]), device=self.env.device
        )
        state = self._state.copy()
        state[AGENTS, "action"] = chosen[None]
        after = self.env.step(state)["next"]
        self._state = after
        self._pictures.tell_endings(after)
        rewards = after[AGENTS, "reward"][0, :, 0].tolist()
        ends = [bool(after[name].any()) for name in ("terminated", "truncated")]
        agents, self.agents = self.agents, [] if any(ends) else self.agents
        terminations, truncations = (dict.fromkeys(agents, end) for end in ends)
        by_agent = dict(zip(agents, rewards, strict=True))
        return self._observe(), by_agent, terminations, truncations, self._tell()

    def render(self) -> Array:
        """Return a picture of the flow ``[height, width, 3]``, uint8.

        Raises:
            ValueError: without ``render_mode="rgb_array"``, and before the first reset.
        """
        if not hasattr(self, "_state"):
            raise ValueError("render: reset() first")
        return self._pictures.paint()[0]

    def close(self) -> None:
        """Close the environment and its solver."""
        self.env.close(raise_if_closed=False)

    def _observe(self) -> dict[str, Array]:
        rows = self._state[AGENTS, "observation_stack"][0].cpu().numpy().astype(np.float32)
        return dict(zip(self.possible_agents, rows, strict=True))

    def _tell(self) -> dict[str, dict[str, Any]]:
        """Return the reports of the flow and the legal actions, by fish."""
        flow = {
            name: self._state[name][0].cpu().numpy()
            for name in self.env.full_observation_spec
            if name != AGENTS
        }
        infos = {name: dict(flow) for name in self.possible_agents}
        for term in name_terms(self.env):
            for name, value in zip(self.possible_agents, self._state[AGENTS, term][0], strict=True):
                infos[name][term] = value.cpu().numpy()
        if not self.is_continuous:
            masks = self._state[AGENTS, "action_mask"][0].cpu().numpy().astype(np.int8)
            for name, mask in zip(self.possible_agents, masks, strict=True):
                infos[name]["action_mask"] = mask
        return infos
