"""The way in from Gymnasium: flows side by side as one ``gymnasium.vector.VectorEnv``.

It needs ``pip install 'fishrl[gymnasium]'`` and is imported by its own name, since the rest of the
library does without: ``from fishrl.envs.gymnasium import FlowVectorEnv``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from tensordict import TensorDictBase
from torchrl.envs import TransformedEnv
from torchrl.envs.utils import step_mdp

try:
    from gymnasium.error import ResetNeeded
    from gymnasium.spaces import Box, Discrete
    from gymnasium.vector import AutoresetMode, VectorEnv
    from gymnasium.vector.utils import batch_space
except ImportError as error:
    raise ImportError(
        "fishrl.envs.gymnasium needs gymnasium: pip install 'fishrl[gymnasium]'"
    ) from error

if TYPE_CHECKING:
    from fishrl.envs.flow_env import FlowEnv

Array = np.ndarray[Any, Any]
OBSERVED = ("observation", "observation_stack")


class FlowVectorEnv(VectorEnv):
    """An environment of ``make_env`` with Gymnasium's vector interface; B flows are B rows.

    Observations are ``observation_stack`` ``[B, num_stacked * n_obs]``, float32; actions are
    integers ``[B]``, of which the illegal ones are refused with an error. ``infos`` holds
    ``action_mask`` ``[B, num_actions]`` (int8, as ``Discrete.sample`` wants it) and everything else
    that the environment and its task report, such as ``captured``, ``diverged``, ``step_count`` and
    ``episode_reward``, each with its ``_``-prefixed array of the rows that have it. A row whose
    flow diverges is truncated with reward 0.

    How rows that end begin anew is Gymnasium's choice of three (``autoreset_mode``):

    ``NEXT_STEP``
        the step after the end resets the row, ignores its action, and gives reward 0; its flow does
        not advance meanwhile. Leave that step out of what is learned from.
    ``SAME_STEP``
        the step that ends an episode returns the first observation of the next one; the last one
        is ``infos["final_obs"]`` (None in other rows), its infos are ``infos["final_info"]``.
    ``DISABLED``
        ``reset(options={"reset_mask": rows})`` resets rows, and has to before the next step.

    Args:
        env: of ``make_env``; this wrapper takes it over and closes it.
        autoreset_mode: one of the three, as ``gymnasium.vector.AutoresetMode`` or its value.

    Raises:
        ValueError: if there is no such mode.
    """

    def __init__(
        self,
        env: TransformedEnv,
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    ) -> None:
        self.env = env
        self.autoreset_mode = _as_mode(autoreset_mode)
        self.num_envs = int(env.batch_size[0])
        specs = env.full_observation_spec
        shape = tuple(specs["observation_stack"].shape[1:])
        self.single_observation_space = Box(-np.inf, np.inf, shape, np.float32)
        self.single_action_space = Discrete(int(specs["action_mask"].shape[-1]))
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.metadata = {"autoreset_mode": self.autoreset_mode, "render_modes": []}
        self._told = [name for name in specs.keys(True, True) if name not in OBSERVED]
        self._state: TensorDictBase | None = None
        self._is_over = np.zeros(self.num_envs, dtype=np.bool_)

    @property
    def flows(self) -> FlowEnv:
        """The environment without transforms."""
        flows: FlowEnv = self.env.base_env
        return flows

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Begin new episodes in all rows, or in those of ``options["reset_mask"]``.

        Args:
            seed: of the starts from here on; what a row draws depends on seed, row and episode.
            options: ``reset_mask``, ``[B]`` bool, or nothing.

        Returns:
            Observations ``[B, ...]`` and infos of all rows.

        Raises:
            ValueError: if the mask or the seed cannot be.
            gymnasium.error.ResetNeeded: if only some rows shall be reset and none has begun.
        """
        rows = self._read_mask(options)
        if seed is not None:
            if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
                raise ValueError(f"seed = {seed}: give one whole number; rows draw their own")
            super().reset(seed=int(seed))
            self.env.set_seed(int(seed), static_seed=True)
        if rows is None:
            self._state = self.env.reset()
            self._is_over[:] = False
        else:
            self._state = self._reset_rows(self._need_state(), rows)
            self._is_over = self._is_over & ~rows
        return _observe(self._state), self._tell(self._state)

    def step(self, actions: Any) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
        """Let every fish act once.

        Args:
            actions: ``[B]`` integers, legal ones.

        Returns:
            Observations ``[B, ...]``, rewards ``[B]``, terminations, truncations and infos.

        Raises:
            ValueError: if actions are illegal, or of a wrong shape; and without autoreset, if
                rows are over.
            gymnasium.error.ResetNeeded: before the first reset.
        """
        state, waiting = self._need_state(), self._is_over.copy()
        if waiting.any() and self.autoreset_mode is AutoresetMode.DISABLED:
            raise ValueError(
                f"rows {waiting.nonzero()[0].tolist()} are over: call "
                "reset(options={'reset_mask': terminations | truncations}) first"
            )
        after = self._advance(state, self._read_actions(actions), waiting)
        rewards, terminations, truncations = (
            np.where(waiting, 0, _row_wise(after[name]))
            for name in ("reward", "terminated", "truncated")
        )
        is_over = terminations.astype(np.bool_) | truncations.astype(np.bool_)
        infos: dict[str, Any] = {}
        if self.autoreset_mode is AutoresetMode.SAME_STEP:
            if is_over.any():
                infos = self._tell_ends(after, is_over)
                after = self._reset_rows(after, is_over)
        else:
            if waiting.any():
                after = self._reset_rows(after, waiting)
            self._is_over = is_over
        self._state = after
        return (
            _observe(after),
            rewards.astype(np.float64),
            terminations.astype(np.bool_),
            truncations.astype(np.bool_),
            infos | self._tell(after),
        )

    def action_masks(self) -> Array:
        """Return which actions are legal now, ``[B, num_actions]`` bool."""
        mask: Array = self._need_state()["action_mask"].cpu().numpy()
        return mask.copy()

    def close_extras(self, **kwargs: Any) -> None:
        """End the solver's processes, if any."""
        self.env.close(raise_if_closed=False)

    def _need_state(self) -> TensorDictBase:
        if self._state is None:
            raise ResetNeeded("call reset() before step(), action_masks() and partial resets")
        return self._state

    def _advance(
        self, state: TensorDictBase, actions: torch.Tensor, waiting: Array
    ) -> TensorDictBase:
        """Return what follows; flows of ``waiting`` rows stand still and mean nothing."""
        rests = torch.as_tensor(waiting, device=self.env.device)
        legal = state["action_mask"].int().argmax(-1)
        self.flows.is_resting = rests
        try:
            action = torch.where(rests, legal, actions)
            stepped = self.env.step(state.copy().set("action", action))
        finally:
            self.flows.is_resting = torch.zeros_like(rests)
        after: TensorDictBase = step_mdp(stepped, exclude_reward=False)
        return after

    def _reset_rows(self, state: TensorDictBase, rows: Array) -> TensorDictBase:
        """Return the state with new episodes in ``rows``."""
        mask = torch.as_tensor(rows, device=self.env.device).unsqueeze(-1)
        fresh: TensorDictBase = self.env.reset(
            state.copy().set("_reset", mask), select_reset_only=1
        )
        return fresh.exclude("_reset")

    def _read_actions(self, actions: Any) -> torch.Tensor:
        given = np.asarray(actions)
        if given.shape != (self.num_envs,) or not np.issubdtype(given.dtype, np.integer):
            raise ValueError(
                f"actions of shape {given.shape}, {given.dtype}: expected ({self.num_envs},), whole"
            )
        return torch.as_tensor(given, dtype=torch.int64, device=self.env.device)

    def _read_mask(self, options: Mapping[str, Any] | None) -> Array | None:
        """Return the rows that shall be reset, or None for all."""
        unknown = sorted(set(options or {}) - {"reset_mask"})
        if unknown:
            raise ValueError(f"options = {unknown}: there is only 'reset_mask'")
        if not options:
            return None
        rows = np.asarray(options["reset_mask"])
        if rows.shape != (self.num_envs,) or rows.dtype != np.bool_ or not rows.any():
            raise ValueError(
                f"reset_mask of shape {rows.shape}, {rows.dtype}, {int(rows.sum())} set: expected "
                f"({self.num_envs},), bool, at least one set"
            )
        return rows

    def _tell(self, state: TensorDictBase) -> dict[str, Any]:
        """Return infos: what is not observed, with arrays of the rows that have it (all)."""
        return _with_rows(self._read_told(state), np.ones(self.num_envs, dtype=np.bool_))

    def _tell_ends(self, state: TensorDictBase, rows: Array) -> dict[str, Any]:
        """Return last observations and infos of the episodes that end."""
        observations = _observe(state)
        final = np.full(self.num_envs, None, dtype=object)
        for row in rows.nonzero()[0]:
            final[row] = observations[row]
        last = {  # zeros in rows that go on
            name: np.where(rows.reshape(-1, *(1,) * (value.ndim - 1)), value, np.zeros_like(value))
            for name, value in self._read_told(state).items()
        }
        return _with_rows({"final_obs": final, "final_info": _with_rows(last, rows)}, rows)

    def _read_told(self, state: TensorDictBase) -> dict[str, Array]:
        told = {name: _row_wise(state[name]) for name in self._told}
        return told | {"action_mask": told["action_mask"].astype(np.int8)}


def _as_mode(mode: AutoresetMode | str) -> AutoresetMode:
    try:
        return AutoresetMode(mode)
    except ValueError as error:
        allowed = ", ".join(one.value for one in AutoresetMode)
        raise ValueError(f"autoreset_mode = {mode!r}: allowed is {allowed}") from error


def _observe(state: TensorDictBase) -> Array:
    observed: Array = state["observation_stack"].cpu().numpy()
    return observed.astype(np.float32)  # a copy


def _row_wise(tensor: torch.Tensor) -> Array:
    """Return a copy, columns ``[B, 1]`` as ``[B]``."""
    columns = tensor.squeeze(-1) if tensor.dim() == 2 and tensor.shape[-1] == 1 else tensor
    rows: Array = columns.detach().cpu().numpy().copy()
    return rows


def _with_rows(infos: Mapping[str, Any], rows: Array) -> dict[str, Any]:
    """Return infos, each with a copy of ``rows`` under its name with ``_`` before it."""
    return dict(infos) | {f"_{name}": rows.copy() for name in infos}
