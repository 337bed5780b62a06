"""Loggers for runs in other processes, where no fixture reaches. Tests only name them.

Importing this file replaces the flow by kinematic fish, but not where the tests run: there,
all that reads a run's settings imports it too.
"""

import os
import signal
import sys
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import fishrl.envs.flow_env
from fishrl.training import interruption
from fishrl.training.interruption import Interrupted
from fishrl.training.logger import CsvLogger
from tests.envs.kinematic_solver import KinematicSolver

if "pytest" not in sys.modules:
    interruption.TWICE_SECONDS = 60.0  # however slowly a signal that is sent twice arrives
    fishrl.envs.flow_env.InPlaceSolver = KinematicSolver  # type: ignore[misc, assignment]


def await_signal() -> None:
    """Return when this run has noticed a signal, or after ten minutes."""
    remembered = signal.getsignal(signal.SIGTERM).__self__  # type: ignore[union-attr]
    deadline = time.monotonic() + 600.0
    with suppress(Interrupted):
        while time.monotonic() < deadline:
            remembered.check()
            time.sleep(0.05)


class Gliding(CsvLogger):
    """Nothing happens."""


class Marking(CsvLogger):
    """Can leave a mark in the run's folder."""

    def open(self, folder: Path, **arguments: Any) -> None:
        super().open(folder, **arguments)
        self.mark = folder / "mark"


class Lingering(Marking):
    """At frame 8 the sweep can be ended, and the run needs a second before it saves."""

    def log(self, metrics: Mapping[str, float]) -> None:
        super().log(metrics)
        if metrics["frames"] == 8:
            self.mark.touch()
            await_signal()
            time.sleep(1.0)


class Killed(Marking):
    """The end that no program can see coming, at frame 8; but not when the run continues."""

    def log(self, metrics: Mapping[str, float]) -> None:
        super().log(metrics)
        if metrics["frames"] == 8 and not self.mark.exists():
            self.mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
