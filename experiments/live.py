"""Flows on a screen while they train or are evaluated: the setting ``live``."""

from __future__ import annotations

import logging
from typing import Any

from tensordict import TensorDictBase

from experiments.command_line import show_command
from experiments.scenes import TaskView
from experiments.settings import ConfigError, ViewerSettings
from experiments.watching import Watch
from fishrl.viewer import Server, start_drawing

logger = logging.getLogger(__name__)


class LiveView:
    """Streams some flows of an env to a viewer's server on 127.0.0.1, while they run.

    It reads the flows and changes nothing. What it takes of the wall time is limited by
    ``live_share``: frames that would cost more are left out.

    Args:
        base: the env; its ``on_frame`` is set.
        settings: which flows, how often, in what format.
        is_told: whether transforms tell the fish which flow it is in.

    Raises:
        ConfigError: for flows that the env does not have.
        ValueError: if the server does not start.
    """

    def __init__(self, base: Any, settings: ViewerSettings, *, is_told: bool) -> None:
        flows = choose_flows(settings.flows, base.batch_size[0], default=[0])
        view = TaskView(base.task, is_told=is_told, vorticity_limit=settings.vorticity_limit)
        self._server = Server(port=settings.port)
        self._drawing = start_drawing(
            view.scene,
            flows=view.name_flows({}, flows),
            url=self._server.url,
            field_format=settings.field_format,
        )
        self._base = base
        self._watch = Watch(
            base.task,
            view.read,
            rows=flows,
            frames_per_T=settings.frames_per_T,
            give=self._drawing.draw,
            is_once=False,
            share=settings.live_share,
        )
        base.on_frame = self._watch.look
        announce(self._server)

    def settle(self, step: TensorDictBase) -> None:
        """Show the frames of an action that is over; ``step`` ``[B]`` as the env returns it."""
        self._watch.settle(step)

    def restart(self) -> None:
        """Expect other episodes than those that ran."""
        self._watch.restart()

    def close(self) -> None:
        """End the stream and the server; an open window keeps what it has got."""
        self._base.on_frame = None
        self._drawing.close()
        self._server.close()


def choose_flows(flows: list[int] | None, num: int, *, default: list[int]) -> list[int]:
    """Return which of ``num`` flows are shown.

    Raises:
        ConfigError: if one is not there, or named twice, or none is.
    """
    chosen = default if flows is None else list(flows)
    if not chosen or not all(0 <= flow < num for flow in chosen) or len(set(chosen)) < len(chosen):
        raise ConfigError(f"flows={chosen}: give some of 0 to {num - 1}, each once")
    return chosen


def announce(server: Server) -> None:
    """Say how to look."""
    logger.info(
        "live on this machine: a window by `%s`, a browser by %s",
        show_command("rerun", "--connect", server.url),
        server.page,
    )
