"""Whatever takes a generator or a seed leaves the generators of the process as they were."""

import inspect
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from pkgutil import walk_packages
from typing import Any

import gymnasium
import pytest
import torch

import fishrl
from fishrl.envs import Flows, Follower, KarmanGait, Predation, PredationPair, make_env
from fishrl.objectives import FitSettings
from fishrl.training.algorithms.algorithm import Algorithm, find_algorithms
from fishrl.training.policy_spec import PolicySpec
from fishrl.training.settings import LearningSettings
from fishrl.wrappers.gymnasium import FlowVectorEnv
from fishrl.wrappers.pettingzoo import FlowParallelEnv
from tests.envs.conftest import SMALL, keep_straight
from tests.envs.test_transforms import TASK as LINED
from tests.objectives.test_classification import make_network, make_parts
from tests.process_state import leaving_process_as_it_was
from tests.sines import FLOWS, SENSORS

pytestmark = pytest.mark.usefixtures("kinematic")
NAMES = {"generator", "seed"}
TASK, EAGER = Predation(**SMALL, time_limit=2), Flows(num_envs=1, compile=False)
GAIT = KarmanGait(**SMALL | {"wall_margin_bl": 0.25})


def is_error(value: object) -> bool:
    return isinstance(value, type) and issubclass(value, Exception)


def list_seeded() -> dict[str, Callable[..., Any]]:
    """Find all functions, classes and methods of fishrl that take a generator or a seed."""
    found: dict[str, Callable[..., Any]] = {}
    for module in walk_packages(fishrl.__path__, "fishrl."):
        for value in vars(import_module(module.name)).values():
            if getattr(value, "__module__", "") != module.name or is_error(value):
                continue
            own = vars(value).values() if isinstance(value, type) else ()
            for each in (value, *filter(inspect.isfunction, own)):
                if callable(each) and NAMES & {*inspect.signature(each).parameters}:
                    found[each.__qualname__] = each
    return {
        name: found[name]
        for name in sorted(found)
        if not any(part.startswith("_") for part in name.split("."))
        if not getattr(found[name], "__isabstractmethod__", False)
    }


def make(task: Any = TASK) -> Any:
    return make_env(task=task, flows=EAGER, seed=0)


def make_spec(kind: type[Algorithm]) -> PolicySpec:
    return PolicySpec(
        task="toy", num_inputs=4, num_actions=2, is_continuous=not kind.takes_discrete, hidden=(8,)
    )


def give_policy(kind: type[Algorithm]) -> dict[str, Any]:
    own = torch.Generator().manual_seed(1)
    return {"spec": make_spec(kind), "policy": kind().make_policy(make_spec(kind), own)}


#: Arguments by name.
COMMON: dict[str, Any] = {
    "num_inputs": 4,
    "num_actions": 2,
    "num": 2,
    "widths": (4, 8),
    "hidden": (8,),
    "task": TASK,
    "flows": EAGER,
}
#: Arguments of one alone, which are made for it.
OWN: dict[str, Callable[[], dict[str, Any]]] = {
    "AbstractTask.sample_starts": lambda: {"self": TASK},
    "FlowParallelEnv.reset": lambda: {
        "self": FlowParallelEnv(make(PredationPair(**SMALL, time_limit=2)))
    },
    "FlowSingleEnv.reset": lambda: {
        "self": gymnasium.make("fishrl/Predation-v0", flows=EAGER, **SMALL, time_limit=2).unwrapped
    },
    "FlowVectorEnv.reset": lambda: {"self": FlowVectorEnv(make())},
    "LateralLineClassifier": lambda: {"flows": FLOWS, "sensors": SENSORS},
    "describe_episode": lambda: {"policy": "random"},
    "draw_uniform": lambda: {"row": torch.arange(2), "episode": torch.arange(2)},
    "evaluate": lambda: {"policy": "random", "episodes": 1},
    "fit_classifier": lambda: {
        "classifier": make_network(),
        **dict(zip(("training", "validation"), make_parts(), strict=False)),
        "settings": FitSettings(num_epochs=1),
        "noise": 0.1,
    },
    "make_baseline": lambda: {"name": "random"},
    "make_keep_place": lambda: {"task": Follower()},
    **{
        f"make_{name}": lambda: {"task": GAIT}
        for name in ("bang_bang", "passive", "pid", "shedding", "tuned_pid")
    },
    "prepare": lambda: {"policy": "random"},
    "record_piece": lambda: {"env": make(LINED), "number": 0},
    "split_episodes": lambda: {
        "episode": torch.arange(4),
        "label": torch.zeros(4, dtype=torch.int64),
        "shares": (0.5, 0.5),
    },
    "write_dataset": lambda: {
        "env": make(),
        "policy": keep_straight,
        "starts": TASK.sample_starts(1, torch.Generator().manual_seed(0)),
        "name": "seeds-v0",
        "folder": Path(),
    },
    **{
        f"{kind.__name__}.make_policy": lambda kind=kind: {"self": kind(), "spec": make_spec(kind)}
        for kind in find_algorithms().values()
    },
    **{
        f"{kind.__name__}.make_loss": lambda kind=kind: {"self": kind(), **give_policy(kind)}
        for kind in find_algorithms().values()
    },
}
#: What is not called here, and why.
UNTRIED = {
    "ClusterCollector": "its generators are in processes of their own",
    "TrainConfig": "its fields are settings of a program",
    "make_collector": "of a training, whose generators are its own",
}
SEEDED = list_seeded()


@pytest.mark.parametrize("name", sorted(SEEDED.keys() - UNTRIED.keys()))
def test_generator_or_seed_leaves_those_of_the_process_alone(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    given = COMMON | {"generator": torch.Generator().manual_seed(0), "seed": 3}
    given |= OWN.get(name, dict)()
    parameters = inspect.signature(SEEDED[name]).parameters
    chosen = {n: given[n] for n, of in parameters.items() if n in given or of.default is of.empty}
    with leaving_process_as_it_was():
        SEEDED[name](**chosen)


def test_what_is_named_here_exists() -> None:
    assert not {*OWN, *UNTRIED} - SEEDED.keys()


@pytest.mark.parametrize("kind", find_algorithms().values())
def test_learner_with_a_seed_leaves_those_of_the_process_alone(kind: type[Algorithm]) -> None:
    settings = LearningSettings(hidden=(8,), flows=EAGER, batch_size=8)
    with leaving_process_as_it_was():
        kind().make_learner(make_spec(kind), settings)
