"""The live view of a training or an evaluation."""

from tensordict import TensorDictBase
from torchrl.envs import EnvBase

from fishrl.training import Callback
from fishrl.viewer import LiveView, ViewerSettings


class LiveCallback(Callback):
    """Streams some of ``num_flows`` flows to the viewer if the settings say so."""

    def __init__(self, settings: ViewerSettings, *, num_flows: int) -> None:
        self.settings = settings
        self.live: LiveView | None = None
        if settings.live:
            settings.choose_flows(num_flows, default=1)  # raises if one does not exist

    def on_begin(self, env: EnvBase) -> None:
        """Start the live view."""
        if self.settings.live:
            self.live = LiveView(env, self.settings)

    def on_step(self, step: TensorDictBase) -> None:
        """Show the frames of a completed step."""
        if self.live is not None:
            self.live.settle(step)

    def on_new_episodes(self) -> None:
        """Expect new episodes."""
        if self.live is not None:
            self.live.restart()

    def on_close(self) -> None:
        """End the live view."""
        if self.live is not None:
            self.live.close()
