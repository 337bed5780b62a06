"""Trainings that receive a signal, or are killed, in the middle of a step."""

import json
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


KILLED_RUN = """
import json, os, signal, sys
from pathlib import Path
from fishrl.training import Callback, Training, complete, open_run, opening
from tests.training.conftest import QUICK, make_toy_plan
from tests.training.toy_fish import ToyFishEnv, make_any_env
opening.make_env = make_any_env
step, num_steps = ToyFishEnv._step, [0]
def step_or_end(self, td):
    num_steps[0] += self.starts is None  # not of evaluations
    if num_steps[0] == int(sys.argv[2]):
        os.kill(os.getpid(), signal.SIGKILL)
    return step(self, td)
ToyFishEnv._step = step_or_end
class Ending(Callback):
    def on_end(self, *_, **__):
        os.kill(os.getpid(), signal.SIGKILL)
settings = QUICK | json.loads(sys.argv[3])
plan = make_toy_plan(Path(sys.argv[1]), name="run", **settings)
complete(Training(open_run(plan), callbacks=[Ending()]))
"""


def run_and_kill(folder: Path, *, step: int = 0, **settings: Any) -> None:
    """Run a training in another process, which is killed in one of its steps, 0 for its end."""
    done = subprocess.run(
        [sys.executable, "-c", KILLED_RUN, str(folder), str(step), json.dumps(settings)],
        cwd=Path(__file__).parents[2],
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        check=False,
    )
    assert done.returncode == -signal.SIGKILL
