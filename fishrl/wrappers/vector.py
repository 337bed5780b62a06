"""A ``gymnasium.vector.VectorEnv`` of flows."""

from collections.abc import Mapping
from typing import Any, cast

import numpy as np
import torch
from tensordict import TensorDictBase
from torchrl.envs import TransformedEnv
from torchrl.envs.utils import step_mdp

from fishrl.envs.flow_env import FlowEnv
from fishrl.extras import needing
from fishrl.wrappers.pictures import Array, Pictures

with needing("gymnasium", "fishrl.wrappers.gymnasium"):
    from gymnasium.error import ResetNeeded
    from gymnasium.vector import AutoresetMode, VectorEnv
    from gymnasium.vector.utils import batch_space

    from fishrl.wrappers.spaces import make_spaces

OBSERVED = ("observation", "observation_stack")


class FlowVectorEnv(VectorEnv):
    """Wrap an environment of ``make_env`` with B flows as a vector environment of B rows.

    Observations are ``observation_stack`` ``[B, num_stacked * n_obs]``, float32; actions are
    integers ``[B]`` or, if continuous, numbers ``[B, num_actions]`` in [-1, 1]. ``infos`` holds
    ``action_mask`` ``[B, num_actions]`` (int8, for ``Discrete.sample``) of discrete actions and all
    other entries of environment and task, such as ``captured``, ``diverged``, ``step_count`` and
    ``episode_reward``, each with a ``_``-prefixed array of the rows that have it; ``ending`` tells
    how an episode ended in this step, such as "caught". A row whose flow diverges is truncated with
    reward 0.

    Autoreset modes of Gymnasium:

    ``NEXT_STEP``
        The step after the end of an episode resets the row, ignores its action and returns reward
        0; on a CPU the flow does not advance. Exclude that step from learning.
    ``SAME_STEP``
        The step that ends an episode returns the first observation of the next one. The last
        observation is ``infos["final_obs"]`` (None in other rows), its infos and ``ending`` are
        ``infos["final_info"]``.
    ``DISABLED``
        Ended rows must be reset by ``reset(options={"reset_mask": rows})`` before the next step.

    Args:
        env: an environment of ``make_env``; this wrapper closes it.
        autoreset_mode: a ``gymnasium.vector.AutoresetMode`` or its value.
        render_mode: ``rgb_array`` for pictures from ``render`` or ``RecordVideo``, or None.
        field: the field that is drawn: vorticity, pressure or speed.
    """

    def __init__(
        self,
        env: TransformedEnv,
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        field: str = "vorticity",
    ) -> None:
        if env.base_env.task.num_fish > 1:
            raise ValueError(
                f"{type(env.base_env.task).__name__} has several fish, and a Gymnasium environment "
                "has one agent: use fishrl.wrappers.pettingzoo.FlowParallelEnv"
            )
        self.env, self.flows = env, cast("FlowEnv", env.base_env)
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.num_envs = int(env.batch_size[0])
        self.single_observation_space, self.single_action_space = make_spaces(env)
        self.is_continuous = self.flows.task.action_bounds is not None
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.render_mode = render_mode
        self.metadata = {
            "autoreset_mode": self.autoreset_mode,
            "render_modes": ["rgb_array"],
            "render_fps": 8,
        }
        self._pictures = Pictures(env, render_mode=render_mode, field=field)
        reported = env.full_observation_spec.keys(True, True)
        self._reported = [name for name in reported if name not in OBSERVED]
        self._state: TensorDictBase | None = None
        self._is_over = np.zeros(self.num_envs, dtype=np.bool_)

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Start new episodes; return observations ``[B, ...]`` and infos of all rows.

        ``seed``, row and number of the episode determine each later start; without one, the one
        drawn by ``make`` continues, which infos name. ``options`` may hold ``reset_mask`` ``[B]``
        bool, the rows to reset.

        Raises:
            ValueError: for an invalid mask.
            gymnasium.error.Error: for an invalid seed, or a partial reset before a full one.
        """
        if seed is not None:
            super().reset(seed=seed)
            self.env.set_seed(int(seed), static_seed=True)
        if unknown := sorted(set(options or {}) - {"reset_mask"}):
            raise ValueError(f"options = {unknown}: must be 'reset_mask'")
        if not options:
            self._state = self.env.reset()
            self._is_over[:] = False
            self._pictures.begin(np.ones(self.num_envs, dtype=np.bool_))
        else:
            rows = _read("reset_mask", options["reset_mask"], (self.num_envs,), np.bool_)
            self._state = self._reset_rows(self._need_state(), rows)
            self._is_over = self._is_over & ~rows
        every, seed = np.ones(self.num_envs, dtype=np.bool_), self.env.base_env.seed
        return _observe(self._state), self._tell(self._state) | _with_rows(
            {"seed": np.full(self.num_envs, seed, dtype=np.int64)}, every
        )

    def step(self, actions: Any) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
        """Advance all rows by one decision, given legal actions ``[B, ...]``.

        Returns observations ``[B, ...]``, rewards ``[B]``, terminations, truncations and infos.

        Raises:
            ValueError: for illegal actions, a wrong shape, or rows that must be reset first.
            gymnasium.error.ResetNeeded: before the first reset.
        """
        state, waiting = self._need_state(), self._is_over.copy()
        if waiting.any() and self.autoreset_mode is AutoresetMode.DISABLED:
            if self.num_envs == 1:
                raise ValueError("the episode is over: call reset() first")
            raise ValueError(
                f"rows {waiting.nonzero()[0].tolist()} are over: call "
                "reset(options={'reset_mask': terminations | truncations}) first"
            )
        after = self._advance(state, self._read_actions(actions), waiting)
        reward, terminated, truncated = (
            np.where(waiting, 0, _row_wise(after[name])).astype(dtype)
            for name, dtype in (("reward", float), ("terminated", bool), ("truncated", bool))
        )
        is_over, infos = terminated | truncated, dict[str, Any]()
        if is_over.any():
            endings = zip(is_over, self._pictures.tell_endings(after), strict=True)
            words = [ending.words if over and ending else None for over, ending in endings]
            infos["ending"] = np.array(words, dtype=object)
        resets = waiting
        if self.autoreset_mode is AutoresetMode.SAME_STEP:
            resets = is_over
            if is_over.any():
                final = np.full(self.num_envs, None, dtype=object)
                for row in is_over.nonzero()[0]:
                    final[row] = _observe(after)[row]
                last = _with_rows(self._read_reported(after) | infos, is_over)
                infos = {"final_obs": final, "final_info": last}
        else:
            self._is_over = is_over
        infos = _with_rows(infos, is_over)
        self._state = after = self._reset_rows(after, resets) if resets.any() else after
        return _observe(after), reward, terminated, truncated, infos | self._tell(after)

    def action_masks(self) -> Array:
        """Return the currently legal actions, ``[B, num_actions]`` bool.

        Raises:
            ValueError: for a task with continuous actions.
        """
        if self.is_continuous:
            raise ValueError("action_masks: continuous actions have no mask; use PPO or SAC")
        mask: Array = self._need_state()["action_mask"].cpu().numpy()
        return mask.copy()

    def render(self) -> tuple[Array, ...]:
        """Return a picture ``[height, width, 3]``, uint8, of each row's flow.

        Raises:
            ValueError: without ``render_mode="rgb_array"``.
        """
        if self.render_mode is not None:
            self._need_state()
        return self._pictures.paint()

    def close_extras(self, **kwargs: Any) -> None:
        """Close the environment and its solver."""
        self.env.close(raise_if_closed=False)

    def _need_state(self) -> TensorDictBase:
        if self._state is None:
            raise ResetNeeded("call reset() before step(), action_masks() and partial resets")
        return self._state

    def _advance(self, state: TensorDictBase, actions: Array, waiting: Array) -> TensorDictBase:
        """Return the next state; ``waiting`` rows do not advance and are undefined."""
        rests = torch.as_tensor(waiting, device=self.env.device)
        action = torch.as_tensor(actions, device=self.env.device)
        if self.is_continuous:
            action = action.masked_fill(rests[:, None], 0.0)
        else:
            action = torch.where(rests, state["action_mask"].int().argmax(-1), action)
        self.flows.is_resting = rests
        try:
            stepped = self.env.step(state.copy().set("action", action))
        finally:
            self.flows.is_resting = torch.zeros_like(rests)
        after: TensorDictBase = step_mdp(stepped, exclude_reward=False)
        return after

    def _reset_rows(self, state: TensorDictBase, rows: Array) -> TensorDictBase:
        """Return the state with new episodes in ``rows``."""
        self._pictures.begin(rows)
        mask = torch.as_tensor(rows, device=self.env.device).unsqueeze(-1)
        fresh: TensorDictBase = self.env.reset(
            state.copy().set("_reset", mask), select_reset_only=1
        )
        return fresh.exclude("_reset")

    def _read_actions(self, given: Any) -> Array:
        """Return actions ``[B, ...]`` with the type of their space."""
        kind, dtype = (np.floating, np.float32) if self.is_continuous else (np.integer, np.int64)
        return _read("actions", given, self.action_space.shape, kind).astype(dtype)

    def _tell(self, state: TensorDictBase) -> dict[str, Any]:
        """Return all entries but the observations as infos."""
        return _with_rows(self._read_reported(state), np.ones(self.num_envs, dtype=np.bool_))

    def _read_reported(self, state: TensorDictBase) -> dict[str, Array]:
        reported = {name: _row_wise(state[name]) for name in self._reported}
        if self.is_continuous:
            return reported
        return reported | {"action_mask": reported["action_mask"].astype(np.int8)}


def _read(name: str, given: Any, shape: tuple[int, ...] | None, kind: type) -> Array:
    """Return ``given`` as an array; raise ValueError if its shape or kind is wrong."""
    values = np.asarray(given)
    if values.shape != shape or not np.issubdtype(values.dtype, kind):
        raise ValueError(
            f"{name} of shape {values.shape}, {values.dtype}: expected {shape}, {kind.__name__}"
        )
    return values


def _observe(state: TensorDictBase) -> Array:
    observed: Array = state["observation_stack"].cpu().numpy()
    return observed.astype(np.float32)  # a copy


def _row_wise(tensor: torch.Tensor) -> Array:
    """Return a copy as an array, with columns ``[B, 1]`` as ``[B]``."""
    columns = tensor.squeeze(-1) if tensor.dim() == 2 and tensor.shape[-1] == 1 else tensor
    rows: Array = columns.detach().cpu().numpy().copy()
    return rows


def _with_rows(infos: Mapping[str, Any], rows: Array) -> dict[str, Any]:
    """Return infos, each with a copy of ``rows`` under its ``_``-prefixed name."""
    return dict(infos) | {f"_{name}": rows.copy() for name in infos}
