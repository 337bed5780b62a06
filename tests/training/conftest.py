"""Trainings of the point fish, small enough for a second each."""

import csv
import itertools
import resource
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import torch
from tensordict import TensorDictBase
from torchrl.envs.utils import ExplorationType, set_exploration_type

from fishrl.envs import Flows
from fishrl.training import Algorithm, Callback, DiscreteSAC, Plan, Training, open_run
from fishrl.training.algorithms.dqn import DQN
from fishrl.training.algorithms.drqn import DRQN
from fishrl.training.algorithms.ppo import PPO
from fishrl.training.algorithms.sac import SAC
from fishrl.training.learner import Learner
from fishrl.training.run_folder import RunFolder, write_yaml
from tests.training.toy_fish import ToyPredation, make_any_env

DEFAULTS: dict[str, Any] = {
    "flows": Flows(num_envs=8, compile=False),
    "total_frames": 240,
    "warmup_frames": 80,
    "updates_per_frame": 0.25,
    "hidden": (16,),
    "buffer_size": 1000,
    "log_frames": 40,
    "checkpoint_frames": 80,
    "eval_frames": 120,
    "eval_episodes": 6,
    "final_episodes": 10,
}
#: Algorithms with critics, and all.
ACTOR_CRITICS: list[Algorithm] = [DiscreteSAC(), SAC(), PPO(rollout_length=8)]
ALGORITHMS = [*ACTOR_CRITICS, DQN(), DRQN()]
#: Little of what is looked at elsewhere.
QUICK: dict[str, Any] = {"baselines": (), "eval_episodes": 2, "final_episodes": 2}


def make_toy_plan(folder: Path, *, task: dict[str, Any] | None = None, **settings: Any) -> Plan:
    """Make a plan from its settings; ``folder`` is where run folders lie."""
    values: dict[str, Any] = {**DEFAULTS, "folder": str(folder), "preset": "toy", **settings}
    return Plan(task=ToyPredation(**task or {}), **values)


def make_run_folder(plan: Plan) -> RunFolder:
    """Make the folder of a run that has not begun to learn."""
    opened = open_run(plan).enter()
    write_yaml(opened.folder.config, opened.stored)
    return opened.folder


@pytest.fixture(autouse=True, scope="session")
def toy_flows() -> Iterator[None]:
    """Make the flows of the point fish where those of other tasks are made."""
    with pytest.MonkeyPatch.context() as patch:
        for module in ("policies", "opening"):
            patch.setattr(f"fishrl.training.{module}.make_env", make_any_env)
        yield


@pytest.fixture
def traced_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Trace the second gradient step."""
    monkeypatch.setattr("fishrl.training.tracing.EAGER_CALLS", 1)


class Toy:
    """Makes trainings whose run folders lie in one folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.trainings: list[Training] = []

    def begin(self, *, callbacks: Sequence[Callback] = (), **settings: Any) -> Training:
        plan = make_toy_plan(self.folder, **settings)
        self.trainings.append(Training(open_run(plan), callbacks=callbacks))
        return self.trainings[-1]

    def collect(
        self, algorithm: Algorithm, num: int = 8, *, task: Any = None, **settings: Any
    ) -> Learner:
        """Return a learner with the transitions of some decisions of all flows."""
        kind = {"is_continuous": algorithm.takes_continuous and not algorithm.takes_discrete}
        training = self.begin(algorithm=algorithm, task=kind | (task or {}), **settings)
        for batch in itertools.islice(training.collector, num):
            training.learner.store(batch.reshape(-1))
        return training.learner

    def reopen(self, name: str, **changes: Any) -> Training:
        for training in self.trainings:
            training._lock.close()
        self.trainings.append(Training(open_run(self.folder / name, **changes)))
        return self.trainings[-1]

    def rows(self, name: str) -> list[dict[str, str]]:
        return read_rows(self.folder / name)


@pytest.fixture
def toy(tmp_path: Path) -> Iterator[Toy]:
    made = Toy(tmp_path)
    yield made
    for training in made.trainings:
        training._lock.close()


@pytest.fixture(scope="session")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Training:
    """Return a finished training of ``QUICK`` settings that nothing has interrupted."""
    training = Toy(tmp_path_factory.mktemp("whole")).begin(name="whole", **QUICK)
    training.run()
    training.close()
    return training


def answer(policy: torch.nn.Module, states: TensorDictBase) -> dict[str, torch.Tensor]:
    """Return what a policy does greedily, and what it follows from."""
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        written = policy(states.clone())
    return {key: written[key] for key in ("logits", "loc", "action") if key in written}


def read_rows(folder: Path, name: str = "metrics.csv") -> list[dict[str, str]]:
    """Read a metrics file without what depends on the machine."""
    with (folder / name).open(newline="") as file:
        rows = list(csv.DictReader(file))
    return [{k: v for k, v in row.items() if not k.startswith("time/")} for row in rows]


def assert_equal_weights(training: Training, other: Training) -> None:
    theirs = other.learner.loss.state_dict()
    for name, value in training.learner.loss.state_dict().items():
        assert torch.equal(value, theirs[name]), name


@contextmanager
def limited_disk(num_bytes: int) -> Iterator[None]:
    """Let no file grow beyond a size: what a full disk does, for this process alone."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (num_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
