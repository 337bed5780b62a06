"""Trainings that receive a signal in the middle of a step."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from fishrl.training.interruption import Interrupted
from fishrl.training.loop import Training


def run_and_stop(training: Training, env: Any, *, step: int, evaluating: bool = False) -> None:
    """Run a training that gets a SIGTERM in one step of its flows, and fail unless it obeys.

    ``step`` is counted, from 1, among those that collect, or that evaluate with starts of its own.
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


SIGNALLED_RUN = """
import os, sys
from pathlib import Path
from fishrl.training import Interrupted, begin, complete
from tests.training.conftest import QUICK, make_toy_plan
from tests.training.toy_fish import ToyFishEnv, make_toy_env
step, num_steps = ToyFishEnv._step, [0]
def step_and_signal(self, td):
    num_steps[0] += self.starts is None  # not of evaluations
    if num_steps[0] == int(sys.argv[3]):
        os.kill(os.getpid(), int(sys.argv[2]))
    return step(self, td)
ToyFishEnv._step = step_and_signal
plan = make_toy_plan(Path(sys.argv[1]), name="run", **QUICK)
try:
    complete(begin(plan, make_env=make_toy_env))
except Interrupted as end:
    sys.exit(128 + end.number)
"""


def run_and_signal(folder: Path, number: int, *, step: int) -> tuple[int, str]:
    """Return exit status and errors of a run in another process, signalled in one of its steps."""
    done = subprocess.run(
        [sys.executable, "-c", SIGNALLED_RUN, str(folder), str(int(number)), str(step)],
        cwd=Path(__file__).parents[2],
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        check=False,
        capture_output=True,
        text=True,
    )
    return done.returncode, done.stderr
