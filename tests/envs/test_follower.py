"""The follower: starts, contact, reward, bad settings, and a real flow behind a leading fish."""

import math

import pytest
import torch
from tensordict import TensorDict

from fishrl.envs import FlowEnv, Flows, Follower, make_env
from fishrl.envs.control import Bend, ContinuousFrequency
from fishrl.physics.placement import do_overlap
from fishrl.training.baselines import make_baseline
from tests.envs.conftest import SMALL, make_flows

TINY = SMALL | {"body_length": 16, "domain_bl": (6.0, 3.0), "checks_per_action": 20}
TINY["wall_margin_bl"] = 0.3


def with_amplitude(low: float, high: float) -> Bend:
    beat = ContinuousFrequency(frequency_range=(0.7, 1.35), amplitude_range=(low, high))
    return Bend(bend_bl=0.1, response_T=0.25, beat=beat)


def make_now(**values: object) -> TensorDict:
    """Return a measurement of one row."""
    now = {"place": [1.5, 0.0], "age": 0.0, "work": 0.0, "gap": 9.0, "clearance": 99.0} | values
    return TensorDict({k: torch.tensor([v], dtype=torch.float64) for k, v in now.items()}, [1])


def test_reward_is_the_efficiency_or_minus_10_on_failure() -> None:
    task = Follower()
    before = make_now()
    age = task.scales.period / 2
    alone = task.cost_alone * task.stream_speed_bl / 2  # work for the way within T / 2

    def earn(**values: object) -> list[float]:
        return [term.item() for term in task.reward(before, make_now(age=age, **values)).values()]

    assert earn(work=alone) == pytest.approx([0.5, 0.0])
    assert earn(work=alone / 3) == pytest.approx([0.75, 0.0])
    assert earn(work=-1.0) == [1.0, 0.0]
    carried = [1.5 + task.stream_speed_bl / 2, 0.0]
    assert earn(work=alone, place=carried) == pytest.approx([0.0, 0.0])
    for end in ({"gap": 1.0}, {"place": [3.1, 0.0]}, {"place": [1.0, -1.1]}, {"clearance": 1.0}):
        assert task.is_terminated(make_now(**end)).all()
        assert earn(**end) == [0.0, -10.0]


def test_start_in_the_sponge_is_refused_with_the_end_of_the_water() -> None:
    task = Follower(levels=2)
    starts = task.sample_starts(1, torch.Generator())
    starts["head"][:, 0] = task.flow_config().width - 3.0
    with pytest.raises(ValueError, match=r"edges of \[0, 176\] x \[0, 96\], move it in"):
        task.check_starts(starts)


@pytest.mark.usefixtures("kinematic")
def test_contact_ends_the_episode_before_fish_overlap() -> None:
    task = Follower(**TINY, start_y_bl=(0.0, 0.0), start_degrees=0.0)
    env = make_env(task=task, flows=Flows(num_envs=2, compile=False))
    state, ahead = env.reset(), torch.zeros(2, 2)
    for _ in range(9):
        step = env.step(state.set("action", ahead))["next"]
        if step["done"].all():
            break
        state = step.exclude("reward")
    assert step["contact"].all() and step["terminated"].all()
    assert (step["reward"] == -10.0).all()
    solver = env.base_env.solver
    assert not do_overlap(solver.markers(0), solver.markers(1)).any()


def test_leader_is_held_and_follower_bends() -> None:
    env: FlowEnv = make_flows(Follower(**TINY, control=with_amplitude(0.4, 1.0)), 1)
    assert env.task.num_actions == 3 and len(env.task.action_names) == 3
    assert env.reset()["observation"].shape == (1, 16)
    leader = env.solver.bodies[1]
    before = leader.position.clone()
    action = torch.tensor([[1.0, 0.0, -1.0]])
    observed = env.step(TensorDict({"action": action}, [1]))["next", "observation"]
    assert observed[0, -3:].tolist() == pytest.approx([1.0, 0.0, -1.0], abs=1e-6)
    # two time constants per command
    assert env.solver.body.amplitude.item() == pytest.approx(0.4 + 0.6 * math.exp(-2.0), rel=0.02)
    assert (leader.position == before).all() and leader.heading.item() == pytest.approx(torch.pi)
    assert leader.beats.item() == pytest.approx(env.task.interval_T)
    assert env.solver.body.bend.item() < 0.0  # the tail is on the side of the turn
    assert leader.bend.item() == 0.0 and leader.amplitude.item() == 1.0
    assert env.now["work"].item() > 0.0


@pytest.mark.usefixtures("kinematic")
def test_baseline_keeps_the_largest_amplitude() -> None:
    task = Follower(**TINY, control=with_amplitude(0.4, 0.9))
    env = make_env(task=task, flows=Flows(num_envs=2, compile=False))
    state = make_baseline("keep_place", task=task, seed=0)(env.reset())
    assert state["action"].shape == (2, 3) and (state["action"][:, 2] == 1.0).all()
    env.step(state)
    assert env.base_env.solver.body.amplitude_goal.tolist() == pytest.approx([0.9, 0.9])
