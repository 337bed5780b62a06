"""The environment on the real flow: small and for few actions, so the physics is not accurate."""

import math

import pytest
import torch
from tensordict import TensorDict

from fishrl.envs import Flows, Predation, PredationPair, make_env
from tests.envs.conftest import SMALL, act, make_flows

#: A tank of 5 L x 3 L, where an eager action takes about a second.
TINY = SMALL | {
    "body_length": 16,
    "wall_margin_bl": 0.18,
    "domain_bl": (5.0, 3.0),
    "start_x_bl": (2.5, 3.5),
    "food_x_bl": 1.0,
    "food_y_bl": 1.5,
    "food_limits_bl": (1.0, 2.0),
}


@pytest.fixture(scope="module")
def task() -> Predation:
    return Predation(**TINY)


def test_fish_swims_and_turns_as_commanded(task: Predation) -> None:
    env = make_flows(task, 1, seed=3)
    first = env.reset()["observation"]
    for _ in range(3):
        after = act(env, 1)
    assert after["observation"][0, 0] > first[0, 0] + 0.1  # the food has come nearer
    act(env, 2)
    turned = math.degrees(float(env.solver.body.heading[0]) - math.pi)
    assert turned == pytest.approx(15.0, abs=1e-9)


def test_diverged_flow_is_reset_alone_and_swims_on() -> None:
    task = Predation(**TINY, control_interval_T=0.25, checks_per_action=6)
    starts = task.sample_starts(2, torch.Generator().manual_seed(1))
    env, intact = (
        make_env(task=task, flows=Flows(num_envs=2, compile=False), starts=starts) for _ in range(2)
    )
    states = [env.reset(), intact.reset()]
    f = env.base_env.solver.populations()
    f[1] = torch.nan
    env.base_env.solver.set_populations_(f)
    keep = torch.ones(2, dtype=torch.int64)
    (broken, states[0]), (whole, states[1]) = (
        e.step_and_maybe_reset(state.set("action", keep))
        for e, state in zip((env, intact), states, strict=True)
    )
    assert broken["next", "diverged"].squeeze(-1).tolist() == [False, True]
    assert broken["next", "observation_stack"].isfinite().all()
    assert (broken["next"][0] == whole["next"][0]).all()
    solvers = [e.base_env.solver for e in (env, intact)]
    assert torch.equal(*(s.populations()[0] for s in solvers))
    assert not solvers[0].populations()[1].any()
    step, _ = env.step_and_maybe_reset(states[0].set("action", keep))
    assert not step["next", "diverged"].any()


def test_pair_that_meets_ends_its_episode_without_divergence() -> None:
    task = PredationPair(**TINY, control_interval_T=0.5, checks_per_action=12)
    length = task.body_length
    starts = task.sample_starts(1, torch.Generator().manual_seed(0))
    starts["head"] = torch.tensor([[[2.0, 1.5], [2.35, 1.5]]], dtype=torch.float64) * length
    starts["heading"] = torch.tensor([[0.0, math.pi]], dtype=torch.float64)
    env = make_flows(task, 1, starts=starts)
    env.reset()
    keep = TensorDict({"agents": {"action": torch.ones(1, 2).long()}}, [1])
    while not (after := env.step(keep)["next"])["done"].item():
        assert float(env.now["gap"]) >= task.contact_bl * length
    assert float(env.now["gap"]) > 0.5
    assert after["contact"].item() and not after["diverged"].item()
