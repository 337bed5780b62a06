"""Kármán gait without a flow: starts, gears, observation, reward, ends."""

from math import pi
from typing import Any

import pytest
import torch
from tensordict import TensorDict

from fishrl.envs import FlowEnv, KarmanGait
from fishrl.envs.lateral_line import LateralLine
from fishrl.envs.macro_actions import FrequencyBank, MacroActions
from fishrl.envs.stations import SafeArea, StationReward
from fishrl.envs.steering import PIDSteering, PolicySteering
from fishrl.envs.streams import Stream
from tests.envs.conftest import SMALL, act

pytestmark = pytest.mark.usefixtures("kinematic")

ROWS = ((0.5, 1.0, 1.5), (0.6, 1.1, 1.6), (0.7, 1.2, 1.7))
BANK = FrequencyBank(rows=ROWS)
DECELERATE, CRUISE, ACCELERATE = range(3)


def make_task(**arguments: Any) -> KarmanGait:
    settings = {"wall_margin_bl": 0.25, "control_interval_T": 1.0, "checks_per_action": 25}
    return KarmanGait(**{**SMALL, **settings, "control": MacroActions(bank=BANK), **arguments})


def make(num_envs: int = 3, **arguments: Any) -> FlowEnv:
    """Return an environment with one flow a row."""
    task = make_task(**arguments)
    starts = task.sample_starts(num_envs, torch.Generator().manual_seed(0))
    starts["flow_index"] = torch.arange(num_envs) % len(task.stream.speeds_bl)
    return FlowEnv(task=task, num_envs=num_envs, compile_flow=False, starts=starts)


def test_each_row_has_the_stream_of_its_start_and_a_reset_changes_it() -> None:
    env = make(3)
    env.reset()
    unit = env.task.scales.reference_speed
    speed = env.solver.stream_speed
    torch.testing.assert_close(speed / unit, torch.tensor([1.0, 1.25, 1.5]).double())
    env.starts = env.starts[[1]]
    env.reset(TensorDict({"_reset": torch.tensor([[True], [False], [False]])}, [3]))
    torch.testing.assert_close(speed / unit, torch.tensor([1.25, 1.25, 1.5]).double())
    assert env.now["flow_index"].tolist() == [1, 1, 2]


def test_starts_are_drawn_from_the_flows_that_are_asked_for() -> None:
    generator = torch.Generator().manual_seed(1)
    starts = make_task(start_flows=(0, 2)).sample_starts(200, generator)
    assert starts["flow_index"].unique().tolist() == [0, 2]
    assert 0.4 < starts["flow_index"].double().mean() / 2 < 0.6
    assert starts["episode_key"].unique().numel() == 200


def test_noses_start_behind_the_disc_facing_upstream_near_the_middle_line() -> None:
    task = make_task(start_x_bl=(1.2, 1.6), start_y_bl=(-0.2, 0.1))
    starts = task.sample_starts(200, torch.Generator().manual_seed(1))
    x, y = ((starts["head"] - torch.tensor(task.origin)) / task.body_length).unbind(-1)
    assert 1.2 <= x.min() < 1.25 and 1.55 < x.max() <= 1.6
    assert -0.2 <= y.min() < -0.15 and 0.05 < y.max() <= 0.1
    assert (starts["heading"] == pi).all()


def test_accelerating_beats_faster_in_the_row_of_the_flow() -> None:
    env = make(3)
    first = env.reset()
    assert first["observation"][:, 6].tolist() == [0.0, 0.0, 0.0]
    after = act(env, DECELERATE, CRUISE, ACCELERATE)
    frequency = after["frequency"].squeeze(-1)
    torch.testing.assert_close(frequency, torch.tensor([0.5, 1.1, 1.7]).double())
    torch.testing.assert_close(after["observation"][:, 6], frequency.float())
    beats = env.solver.body.frequency * env.task.scales.period
    torch.testing.assert_close(beats, frequency)
    assert after["gear"].squeeze(-1).tolist() == [0, 1, 2]
    mask = [[False, True, True], [True, True, True], [True, True, False]]
    assert after["action_mask"].tolist() == mask


def test_the_named_flow_picks_the_row_and_the_gear_outlasts_a_change_of_name() -> None:
    env = make(2, reads_flow_class=True)
    env.reset()
    after = act(env, ACCELERATE, ACCELERATE, flow_class=[0, 2])
    assert after["frequency"].squeeze(-1).tolist() == [1.5, 1.7]
    after = act(env, CRUISE, CRUISE, flow_class=[1, 0])
    assert after["frequency"].squeeze(-1).tolist() == [1.6, 1.5]
    assert after["gear"].squeeze(-1).tolist() == [2, 2]
    assert after["flow_index"].squeeze(-1).tolist() == [0, 1]


def test_a_named_flow_that_there_is_not_and_a_missing_name_are_refused() -> None:
    env = make(2, reads_flow_class=True)
    env.reset()
    with pytest.raises(ValueError, match=r"flow_class = \[0, 3\]: allowed is 0 to 2"):
        act(env, CRUISE, CRUISE, flow_class=[0, 3])
    with pytest.raises(ValueError, match=r"KarmanGait reads \['flow_class'\].*append the transf"):
        act(env, CRUISE, CRUISE)


def test_the_observation_is_place_way_velocity_and_frequency() -> None:
    env = make(1)
    first = env.reset()["observation"][0]
    place = (env.start["head"] - torch.tensor(env.task.origin))[0] / env.task.body_length
    torch.testing.assert_close(first[:2], place.float(), rtol=0, atol=1e-6)
    # the kinematic fish feels the undisturbed stream of 1 L / T
    torch.testing.assert_close(first[2:], torch.tensor([0.0, 0.0, 1.0, 0.0, 0.0]))
    second = act(env, CRUISE)["observation"][0]
    torch.testing.assert_close(second[2:4], second[:2] - first[:2], rtol=0, atol=1e-6)
    assert second[2] == pytest.approx(-0.4, abs=0.01)  # it glides 0.4 L in one beat of 1 / T


def test_a_shorter_interval_takes_fewer_steps_and_is_timed_in_periods() -> None:
    env = make(1, control_interval_T=0.5, lateral_line=LateralLine(num_samples=2, features=("t",)))
    assert env.task.interval_T == pytest.approx(0.5, abs=0.01)
    first = env.reset()["observation"][0]
    after = act(env, CRUISE)
    assert after["observation"][0, 0] - first[0] == pytest.approx(-0.2, abs=0.01)
    time = after["lateral_line"][0, :, 0, 0]
    torch.testing.assert_close(time, torch.tensor([0.25, 0.5]), rtol=0, atol=0.01)


def test_the_frequency_may_be_repeated_as_the_paper_does() -> None:
    env = make(1, repeats_frequency=True)
    env.reset()
    observation = act(env, ACCELERATE)["observation"][0]
    assert observation.shape == (9,) and observation[6:].tolist() == [1.5, 1.5, 1.5]


def test_the_policy_may_go_without_the_velocity_at_the_lateral_line() -> None:
    full, blind = make(1), make(1, observes_velocity=False)
    full.reset(), blind.reset()
    seen, left = act(full, ACCELERATE)["observation"][0], act(blind, ACCELERATE)["observation"][0]
    assert seen[4:6].abs().max() > 0.0 and left.shape == (5,)
    torch.testing.assert_close(left, seen[[0, 1, 2, 3, 6]])


def test_the_lateral_line_is_handed_over_as_a_series() -> None:
    line = LateralLine(num_neuromasts=3, num_samples=4, features=("t", "u_x"))
    env = make(2, lateral_line=line)
    first = env.reset()["lateral_line"]
    assert first.shape == (2, 4, 3, 2) and (first[..., 0] == 0.0).all()
    time = act(env, CRUISE, CRUISE)["lateral_line"][0, :, 0, 0]
    torch.testing.assert_close(time, torch.tensor([0.25, 0.5, 0.75, 1.0]), rtol=0, atol=0.01)
    layout = env.task.lateral_line_layout
    assert layout["num_samples"] == 4 and layout["interval_T"] == 0.25


def test_a_resting_row_keeps_what_it_sensed_last(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a GPU its flow goes on, and may diverge."""
    env = make(2)
    before = env.reset()["lateral_line"]
    solver, sample = env.solver, env.solver.sample
    lost = torch.tensor([0.0, torch.nan])[:, None]
    monkeypatch.setattr(
        solver, "sample", lambda at: (sample(at)[0] + lost, sample(at)[1] + lost[..., None])
    )
    env.is_resting = torch.tensor([False, True])
    after = act(env, CRUISE, CRUISE)
    assert torch.equal(after["lateral_line"][1], before[1])
    assert after["observation"].isfinite().all()


def test_a_late_lateral_line_holds_the_interval_before() -> None:
    line = LateralLine(num_samples=4, features=("t",), delay=2)
    env = make(1, lateral_line=line)
    env.reset()
    act(env, CRUISE)
    time = act(env, CRUISE)["lateral_line"][0, :, 0, 0]
    torch.testing.assert_close(time, torch.tensor([0.75, 1.0, 1.25, 1.5]), rtol=0, atol=0.01)


def test_steering_turns_the_fish_back_to_the_middle_line() -> None:
    env = make(2, steering=PIDSteering(gain=0.5, integral_gain=0.0), start_y_bl=(0.1, 0.1))
    env.reset()
    act(env, CRUISE, CRUISE)
    expected = torch.full((2,), pi + 0.05, dtype=torch.float64)
    torch.testing.assert_close(env.now["heading"], expected, rtol=0, atol=1e-6)
    after = env.task.report(env.now)
    torch.testing.assert_close(after["angle_of_attack"], expected - pi)


def test_reward_ends_and_drift_follow_from_the_way() -> None:
    env = make(1, start_flows=(0,), reward_terms=StationReward(work_weight=0.0))
    env.reset()
    assert act(env, CRUISE)["reward"].item() == 1.0  # it glides upstream
    env.now["place"][:, 0] -= 1.0  # as if it had been farther upstream before
    assert act(env, CRUISE)["reward"].item() == -1.0


def test_work_is_told_in_rho_L2_of_L_per_T_and_paid_for_by_the_interval() -> None:
    env = make(1, start_flows=(0,), reward_terms=StationReward(rim_weight=0.0))
    env.reset()
    unit = (20 * 20 / env.task.scales.period) ** 2  # rho L^2 (L / T)^2
    done = {"work": 0.3, "positive_work": 0.5, "lateral_work": 0.2}
    for name, share in done.items():
        getattr(env.solver.body, name).fill_(share * unit)
    first, second = act(env, CRUISE), act(env, CRUISE)
    assert {name: first[name].item() for name in done} == pytest.approx(done)
    assert first["reward"].item() == pytest.approx(1.0 + 0.1 * (1.0 - 0.3 / 0.1))
    assert second["reward"].item() == pytest.approx(1.0 + 0.1)  # nothing was done since


@pytest.mark.parametrize(
    ("x", "y"), [(0.6, 0.0), (2.0, 0.93), (2.0, -0.93)], ids=["near", "above", "below"]
)
def test_the_danger_area_ends_an_episode_and_costs(x: float, y: float) -> None:
    env = make(
        1,
        steering=PIDSteering(gain=0.0, integral_gain=0.0),
        reward_terms=StationReward(rim_weight=0.0),
    )
    env.reset()
    place = 20 * torch.tensor([[x + env.task.fish.centre / 20, y]])
    env.solver.body.position.copy_(torch.tensor(env.task.origin) + place)
    if y:
        env.solver.body.heading.add_(-0.4 if y > 0 else 0.4)  # and outwards
    after = act(env, CRUISE)
    assert after["terminated"].all()
    assert after["reward"].item() < 1.2 - 5.0


def test_nearness_to_danger_costs_by_depth() -> None:
    area = SafeArea(near_bl=0.4, rim_bl=0.5)
    env = make(1, safe_area=area, reward_terms=StationReward(work_weight=0.0))
    env.reset()
    now = env.now.clone()
    now["place"] = torch.tensor([[0.7, 0.0]]).double()
    assert env.task.reward(env.now, now).item() == pytest.approx(1.0 - 10.0 * 0.2)


def test_a_free_stream_needs_no_disc_and_no_wake() -> None:
    task = make_task(stream=Stream(has_disc=False))
    assert len(task.flow_config().bodies) == 1 and task.wakes is None
    make_task(stream=Stream(has_disc=False, diameter_bl=0.1))  # too small, but not there
    assert [label["diameter_bl"] for label in task.flow_labels] == [0.0, 0.0, 0.0]
    env = FlowEnv(task=task, num_envs=2, compile_flow=False)
    env.reset()
    assert act(env, CRUISE, CRUISE)["observation"].isfinite().all()


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ({"start_flows": ()}, r"start_flows = \(\): give one or more of the indices 0 to 2"),
        ({"stream": Stream(speeds_bl=(1.0,)), "start_flows": (0,)}, "control has rows for 3 flows"),
        ({"start_x_bl": (0.3, 1.0)}, r"nose at \(0.30, -0.10\) L from the disc, is in the danger"),
        (
            {"steering": PolicySteering()},
            "decisions_per_T = 4, but the control interval is 1 T: give 1",
        ),
    ],
)
def test_tasks_that_cannot_be_are_refused(bad: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make_task(**bad)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("flow_index", 3, r"starts\['flow_index'\] = \[3\]: allowed is 0 to 2"),
        ("wake_phase", 1.0, r"starts\['wake_phase'\] = \[1.0\]: allowed is \[0, 1\)"),
    ],
)
def test_starts_that_cannot_be_are_refused(key: str, value: float, message: str) -> None:
    task = make_task()
    starts = task.sample_starts(1, torch.Generator().manual_seed(0))
    starts[key].fill_(value)
    with pytest.raises(ValueError, match=message):
        task.check_starts(starts)
