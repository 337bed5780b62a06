"""A collector that continues exactly where it was stopped."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from tensordict import TensorDict
from torchrl.collectors import Collector
from torchrl.envs import ActionMask, EnvBase

from fishrl.training.evaluation import copy_state


class ResumableCollector(Collector):
    """TorchRL's collector, whose state also holds the flows and the state they are about to act in.

    The parent saves the buffers of the transforms and its counters, but neither the base env nor
    the TensorDict that it carries from step to step: after loading, episodes would start anew on
    the frame stacks of the old ones.
    """

    def state_dict(self) -> OrderedDict:
        """Return everything the next batch depends on, apart from the global generators."""
        state = super().state_dict()
        state["base_env"] = self.env.base_env.state_dict()
        state["carrier"] = self._carrier.clone().to_dict()
        return state

    def load_state_dict(self, state_dict: Any, **kwargs: Any) -> None:
        """Restore what ``state_dict`` returned into a collector of an equal env."""
        state = dict(state_dict)
        base_env, carrier = state.pop("base_env"), state.pop("carrier")
        super().load_state_dict(OrderedDict(state), **kwargs)
        if self.track_traj_ids:  # the parent counted on fresh trajectories
            self._traj_pool.load_state_dict(state["traj_pool"])
        self.env.base_env.load_state_dict(base_env)
        self._carrier: TensorDict = TensorDict.from_dict(
            carrier, batch_size=self.env.batch_size, device=self.env.device
        )
        for transform in self.env.transform:
            if isinstance(transform, ActionMask):  # it keeps the mask inside the action spec
                transform._call(self._carrier)

    @contextmanager
    def lend_env(self) -> Iterator[EnvBase]:
        """Lend the env, and restore everything afterwards."""
        state = copy_state(self.state_dict())
        try:
            yield self.env
        finally:
            self.load_state_dict(state)
