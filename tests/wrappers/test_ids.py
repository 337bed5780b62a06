"""Gymnasium ids, single flows, films, and several fish in PettingZoo."""

from collections.abc import Callable
from functools import partial
from importlib import import_module
from pkgutil import walk_packages
from secrets import randbits
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from pettingzoo.test import parallel_api_test
from tensordict import TensorDictBase

from fishrl import wrappers
from fishrl.benchmark import list_versions
from fishrl.envs import Flows, Predation, PredationPair, make_env, make_task, making
from fishrl.envs.control import Turn
from fishrl.wrappers.gymnasium import TASKS, FlowVectorEnv
from fishrl.wrappers.pettingzoo import FlowParallelEnv
from fishrl.wrappers.stable_baselines import FlowVecEnv
from tests.envs.conftest import CONTINUOUS, SMALL

pytestmark = pytest.mark.usefixtures("kinematic")
PREFIX = "fishrl.wrappers."
EAGER = Flows(num_envs=1, compile=False)
SETTINGS = {**SMALL, "time_limit": 3, "flows": Flows(compile=False)}


def test_ids_make_vector_and_single_environments() -> None:
    envs = gymnasium.make_vec("fishrl/Predation-v0", num_envs=2, **SETTINGS)
    assert isinstance(envs.unwrapped, FlowVectorEnv) and envs.num_envs == 2
    observations, _ = envs.reset(seed=3)
    assert set(TASKS) <= set(gymnasium.registry)
    env = gymnasium.make("fishrl/Predation-v0", **SETTINGS)
    observation, info = env.reset(seed=3)
    assert np.array_equal(observation, observations[0])
    assert info["action_mask"].shape == (3,)
    check_env(env.unwrapped, skip_render_check=True)
    env.reset(seed=3)
    while not any(env.step(1)[2:4]):
        pass
    for made in (envs, env):
        made.close()
    with pytest.raises(ValueError, match="body_lenght"):
        gymnasium.make("fishrl/Predation-v0", body_lenght=50)
    with pytest.raises(ValueError, match="autoreset_mode: gymnasium"):
        gymnasium.make("fishrl/Predation-v0", autoreset_mode="SameStep")


def test_specs_are_written_as_json() -> None:
    for name in TASKS:
        spec = gymnasium.envs.registration.EnvSpec.from_json(gymnasium.spec(name).to_json())
        assert spec.kwargs == {"task": name}


def test_presets_have_ids() -> None:
    env = gymnasium.make("fishrl/quick", **SETTINGS)
    assert env.unwrapped.vector.flows.task == make_task("quick", **SMALL, time_limit=3)
    env.close()
    assert {f"fishrl/{name}" for name in list_versions()} <= set(gymnasium.registry)
    with pytest.raises(gymnasium.error.NameNotFound, match="Did you mean: `gait_bend`"):
        gymnasium.make("fishrl/gait_bent")


WRAPPED: list[Callable[[], Any]] = [
    partial(gymnasium.make, "fishrl/Predation-v0", **SETTINGS),
    partial(gymnasium.make_vec, "fishrl/Predation-v0", num_envs=2, **SETTINGS),
    lambda: FlowVecEnv(make_env(task=Predation(**SMALL), flows=EAGER)),
    lambda: FlowParallelEnv(make_env(task=PredationPair(**SMALL), flows=EAGER)),
    lambda: make_env(task=Predation(**SMALL), flows=EAGER),
]


def test_every_wrapper_of_environments_is_among_these() -> None:
    modules = [import_module(each.name) for each in walk_packages(wrappers.__path__, PREFIX)]
    kinds = {
        kind
        for module in modules
        for kind in vars(module).values()
        if isinstance(kind, type) and kind.__module__.startswith(PREFIX) and "reset" in vars(kind)
    }
    assert len(kinds) > 3 and kinds <= {
        type(getattr(make(), "unwrapped", None)) for make in WRAPPED
    }


def read_start(env: Any) -> str:
    """Return what an environment of any framework observes first."""
    seen = env.reset()
    seen = seen["observation"] if isinstance(seen, TensorDictBase) else seen
    return str(seen[0] if isinstance(seen, tuple) else seen)


@pytest.mark.parametrize("make", WRAPPED)
def test_unseeded_starts_differ(make: Callable[[], Any], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(making, "randbits", randbits)
    assert len({read_start(make()) for _ in range(3)}) == 3


def test_environments_without_seed_tell_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(making, "randbits", randbits)
    first, other = (gymnasium.make("fishrl/Predation-v0", **SETTINGS) for _ in range(2))
    (start, info), (another, _) = first.reset(), other.reset()
    assert not np.array_equal(start, another)
    assert np.array_equal(start, other.reset(seed=int(info["seed"]))[0])
    assert np.array_equal(first.reset(seed=1)[0], other.reset(seed=1)[0])


@pytest.mark.parametrize("control", [Turn(), CONTINUOUS], ids=["discrete", "continuous"])
def test_several_fish_pass_pettingzoo_test(control: Turn) -> None:
    task = PredationPair(**SMALL, time_limit=3, control=control)
    env = FlowParallelEnv(make_env(task=task, flows=Flows(num_envs=1, compile=False)))
    parallel_api_test(env, num_cycles=10)
    env.reset(seed=1)
    with pytest.raises(ValueError, match=r"expected \['fish_0', 'fish_1'\]"):
        env.step({"fish_0": 1})
    env.close()
    with pytest.raises(ValueError, match=r"one flow, not 2: flows=Flows\(num_envs=1\)"):
        FlowParallelEnv(make_env(task=task, flows=Flows(num_envs=2, compile=False)))


def test_pair_is_rendered() -> None:
    flow = make_env(
        task=PredationPair(**SMALL, time_limit=3), flows=Flows(num_envs=1, compile=False)
    )
    env = FlowParallelEnv(flow, render_mode="rgb_array")
    env.reset(seed=1)
    first = env.render()
    env.step({"fish_0": 1, "fish_1": 1})
    second = env.render()
    assert first.shape == second.shape and first.dtype == np.uint8
    assert 0.0 < (first != second).mean() < 0.5
    env.close()
