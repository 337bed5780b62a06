"""Trainings that receive SIGTERM in the middle of a step."""

from __future__ import annotations

import signal
from typing import Any

import pytest

from fishrl.training.interruption import Interrupted
from fishrl.training.loop import Training


def run_and_stop(training: Training, env: Any, *, step: int, evaluating: bool = False) -> None:
    """Run a training that gets a SIGTERM in one step of its flows, and fail unless it obeys.

    Args:
        training: to run.
        env: class of its environment.
        step: the number, from 1, of the step among those that collect, or that evaluate.
        evaluating: count the steps of evaluations, which have starts of their own.
    """
    original, left = env._step, [step]

    def step_and_count(self: Any, td: Any) -> Any:
        left[0] -= (self.starts is not None) == evaluating
        if left[0] == 0:
            training.interruption.request(signal.SIGTERM)
        return original(self, td)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(env, "_step", step_and_count)
        with pytest.raises(Interrupted, match="SIGTERM"):
            training.run()
