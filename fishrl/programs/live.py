"""The live view of a training or an evaluation."""

from __future__ import annotations

from tensordict import TensorDictBase
from torchrl.envs import EnvBase

from fishrl.training import Callback
from fishrl.viewer import LiveView, ViewerSettings


class LiveObserver(Callback):
    """Streams some of ``num_flows`` flows to the viewer if the settings say so."""

    def __init__(self, settings: ViewerSettings, *, num_flows: int) -> None:
        self.settings = settings
        self.live: LiveView | Observer = Observer()  # which does nothing
        if settings.live:
            settings.choose_flows(num_flows, default=1)  # raises if one does not exist

    def begin(self, env: EnvBase) -> None:
        """Start the live view."""
        if self.settings.live:
            self.live = LiveView(env, self.settings)

    def settle(self, step: TensorDictBase) -> None:
        """Show the frames of a completed step."""
        self.live.settle(step)

    def restart(self) -> None:
        """Expect new episodes."""
        self.live.restart()

    def close(self) -> None:
        """End the live view."""
        self.live.close()
