"""Policies out of archives of Stable-Baselines3, ``model.save("fish")``."""

from dataclasses import dataclass
from inspect import signature
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase

from fishrl.extras import needing


@dataclass(frozen=True)
class Archive:
    """A policy, and what its archive says of it."""

    policy: Any  #: of Stable-Baselines3, with ``predict``
    num_inputs: int  #: length of its observation
    num_actions: int  #: choices of an action, or numbers of a continuous one
    is_discrete: bool
    decisions: int  #: of its training

    def __call__(self, state: TensorDictBase) -> TensorDictBase:
        """Write ``action`` ``[B]`` or ``[B, num_actions]``, the most probable legal one."""
        more: dict[str, Any] = {}
        if "action_mask" in state and "action_masks" in signature(self.policy.predict).parameters:
            more["action_masks"] = state["action_mask"].cpu().numpy()
        seen = state["observation_stack"].cpu().numpy().astype(np.float32)
        actions, _ = self.policy.predict(seen, deterministic=True, **more)
        action = torch.as_tensor(actions, device=state["observation_stack"].device)
        state["action"] = action if action.is_floating_point() else action.long()
        return state


def load_archive(path: Path) -> Archive:
    """Load the policy of an archive, on the CPU. This unpickles, and so runs, code from it.

    Raises:
        FileNotFoundError: if there is no file.
        ValueError: for a file that is none, and for a recurrent policy.
    """
    with needing("stable-baselines3", str(path)):
        from stable_baselines3.common.save_util import load_from_zip_file
    if not path.is_file():  # Stable-Baselines3 would name another
        raise FileNotFoundError(f"{path}: no such file")
    data, params, _ = load_from_zip_file(path, device="cpu")
    if data is None or "policy_class" not in data or "policy" not in params:
        raise ValueError(f"{path}: no archive of Stable-Baselines3; model.save writes one")
    kind, made = data["policy_class"], dict(data.get("policy_kwargs") or {})
    if "lstm_hidden_size" in signature(kind.__init__).parameters:
        raise ValueError(f"{path}: has a memory of its own; give a function, module:function")
    if "use_sde" in signature(kind.__init__).parameters:
        made.setdefault("use_sde", data.get("use_sde", False))
    policy = kind(data["observation_space"], data["action_space"], lambda _: 0.0, **made)
    policy.load_state_dict(params["policy"])
    shape = data["observation_space"].shape
    if shape is None or len(shape) != 1:
        raise ValueError(f"{path}: observes {data['observation_space']}; must be a row of numbers")
    space = data["action_space"]
    num_actions = getattr(space, "n", None) or sum(space.shape)
    trained = int(data.get("num_timesteps", 0))
    return Archive(policy, int(shape[0]), int(num_actions), hasattr(space, "n"), trained)
