"""Kármán gait without a flow: starts, gears, observation, reward, ends."""

from dataclasses import replace
from math import pi
from typing import Any

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import check_env_specs

from fishrl.envs import FlowEnv, Flows, KarmanGait, Oracle, make_env
from fishrl.envs.control import MacroActions
from fishrl.envs.lateral_line import LateralLine
from fishrl.envs.stations import StationReward
from fishrl.envs.steering import PIDSteering
from tests.envs.conftest import SMALL, act, make_flows, reset_rows

pytestmark = pytest.mark.usefixtures("kinematic")

ROWS = ((0.5, 1.0, 1.5), (0.6, 1.1, 1.6), (0.7, 1.2, 1.7))
DECELERATE, CRUISE, ACCELERATE = range(3)


def make_task(**arguments: Any) -> KarmanGait:
    settings = {"wall_margin_bl": 0.25, "control_interval_T": 1.0, "checks_per_action": 25}
    return KarmanGait(**{**SMALL, **settings, "control": MacroActions(rows=ROWS), **arguments})


def begin(num_envs: int = 1, **arguments: Any) -> tuple[FlowEnv, TensorDict]:
    """Return an environment with one flow a row, and its first state."""
    task = make_task(**arguments)
    starts = task.sample_starts(num_envs, torch.Generator().manual_seed(0))
    starts["flow_index"] = torch.arange(num_envs) % len(task.stream.speeds_bl)
    env = make_flows(task, num_envs, starts=starts)
    return env, env.reset()


def close(*values: float) -> Any:
    """Return float64 numbers to be met within 0.01."""
    return pytest.approx(values, abs=0.01)


def place_nose(env: FlowEnv, row: int, x: float, y: float = 0.0) -> None:
    """Move a fish that faces upstream to a place, in body lengths from the disc's flat side."""
    place = torch.tensor([20.0 * x + env.task.fish.centre, 20.0 * y])
    env.solver.body.position[row] = torch.tensor(env.task.origin) + place


def test_starts_are_uniform_in_the_given_flows_and_places() -> None:
    task = make_task(start_flows=(0, 2), start_x_bl=(1.2, 1.6), start_y_bl=(-0.2, 0.1))
    starts = task.sample_starts(200, torch.Generator().manual_seed(1))
    assert starts["flow_index"].unique().tolist() == [0, 2]
    assert 0.4 < starts["flow_index"].double().mean() / 2 < 0.6
    assert starts["episode_key"].unique().numel() == 200
    x, y = ((starts["head"] - torch.tensor(task.origin)) / task.body_length).unbind(-1)
    assert 1.2 <= x.min() < 1.25 and 1.55 < x.max() <= 1.6
    assert -0.2 <= y.min() < -0.15 and 0.05 < y.max() <= 0.1
    assert (starts["heading"] == pi).all()


def test_actions_shift_gear_in_row_of_flow() -> None:
    env, first = begin(3)
    assert first["observation"][:, 6].tolist() == [0.0, 0.0, 0.0]
    after = act(env, DECELERATE, CRUISE, ACCELERATE)
    frequency = after["frequency"].squeeze(-1)
    assert frequency.tolist() == [0.5, 1.1, 1.7]
    torch.testing.assert_close(after["observation"][:, 6], frequency.float())
    torch.testing.assert_close(env.solver.body.frequency * env.task.scales.period, frequency)
    assert after["gear"].squeeze(-1).tolist() == [0, 1, 2]
    mask = [[False, True, True], [True, True, True], [True, True, False]]
    assert after["action_mask"].tolist() == mask


def test_flow_label_selects_the_row_and_leaves_the_gear() -> None:
    env, _ = begin(2, reads_flow_class=True)
    for action, label, expected in ((ACCELERATE, [0, 2], [1.5, 1.7]), (CRUISE, [1, 0], [1.6, 1.5])):
        after = act(env, action, action, flow_class=label)
        assert after["frequency"].squeeze(-1).tolist() == expected
        assert after["gear"].squeeze(-1).tolist() == [2, 2]
        assert after["flow_index"].squeeze(-1).tolist() == [0, 1]
    env = make_env(
        task=make_task(reads_flow_class=True), flows=Flows(num_envs=2, compile=False),
        starts=env.starts.flip(0), recognition=Oracle(),
    )  # fmt: skip
    state = env.reset()
    assert state["observation_stack"].shape == (2, (7 + 3) * env.base_env.task.num_stacked)
    after = env.step(state.set("action", torch.tensor([CRUISE, CRUISE])))["next"]
    assert after["frequency"].squeeze(-1).tolist() == [1.1, 1.0]
    check_env_specs(env, seed=0)
    env, _ = begin(2, reads_flow_class=True)
    with pytest.raises(ValueError, match=r"flow_class = \[0, 3\]: allowed is 0 to 2"):
        act(env, CRUISE, CRUISE, flow_class=[0, 3])
    with pytest.raises(ValueError, match=r"KarmanGait reads \['flow_class'\].*append the transf"):
        act(env, CRUISE, CRUISE)


def test_default_observation_is_place_drift_velocity_and_beat() -> None:
    env, state = begin()
    first = state["observation"][0]
    place = (env.start["head"] - torch.tensor(env.task.origin))[0] / env.task.body_length
    torch.testing.assert_close(first[:2], place.float(), rtol=0, atol=1e-6)
    # the kinematic fish feels the undisturbed stream of 1 L / T
    assert first[2:].tolist() == pytest.approx([0.0, 0.0, 1.0, 0.0, 0.0], abs=1e-6)
    second = act(env, CRUISE)["observation"][0]
    torch.testing.assert_close(second[2:4], second[:2] - first[:2], rtol=0, atol=1e-6)
    assert second[2] == pytest.approx(-0.4, abs=0.01)  # it glides 0.4 L in one beat of 1 / T


def test_senses_are_observed_in_the_given_order() -> None:
    env, _ = begin()
    act(env, ACCELERATE)

    def see(*names: str) -> torch.Tensor:
        return replace(env.task, observes=names).observe(env.now)[0]

    names = ("own_motion", "place", "lateral_line", "heading", "tail_beat", "place", "drift")
    assert all(see(name).any() for name in names)
    assert torch.equal(see(*names), torch.cat([see(name) for name in names]))


def test_lateral_line_is_observed_with_its_change() -> None:
    env, _ = begin(observes=("lateral_line",))
    before = act(env, CRUISE)["lateral_line"][0, -1].flatten()
    after = act(env, CRUISE)
    latest = after["lateral_line"][0, -1].flatten()
    speed = 1.5  # of the fastest stream; pressures are in its square
    units = torch.tensor([speed, speed, speed**2, speed]).repeat(2 * 5)
    expected = torch.cat((latest, latest - before)) / units
    torch.testing.assert_close(after["observation"][0], expected)
    env, start = begin(observes=("lateral_line",))
    assert not start["observation"][0, 20:].any()  # there is no earlier one


@pytest.mark.parametrize(
    ("interval_T", "delay", "expected"),
    [(1.0, 0, (0.25, 0.5, 0.75, 1.0)), (0.5, 0, (0.125, 0.25, 0.375, 0.5)),
     (1.0, 2, (-0.25, 0.0, 0.25, 0.5))],
)  # fmt: skip
def test_line_is_a_series(interval_T: float, delay: int, expected: tuple[float, ...]) -> None:
    line = LateralLine(num_neuromasts=3, num_samples=4, features=("t", "u_x"), delay=delay)
    env, state = begin(2, lateral_line=line, control_interval_T=interval_T)
    assert env.task.interval_T == pytest.approx(interval_T, abs=0.01)
    first = state["lateral_line"]
    assert first.shape == (2, 4, 3, 2) and (first[..., 0] == 0.0).all()
    if delay:  # samples of the interval before
        act(env, CRUISE, CRUISE)
        expected = tuple(time + interval_T for time in expected)
    assert act(env, CRUISE, CRUISE)["lateral_line"][0, :, 0, 0].tolist() == close(*expected)
    layout = env.task.lateral_line_layout
    assert layout["num_samples"] == 4
    assert layout["interval_T"] == pytest.approx(interval_T / 4, abs=0.01)


@pytest.mark.parametrize(("x", "is_first"), [(0.7, False), (0.42, True)])
def test_last_sample_is_repeated(monkeypatch: pytest.MonkeyPatch, x: float, is_first: bool) -> None:
    """The nose reaches x = 0.4 L within the action, or before the first sample.

    Rows that share a launch move on after their end; what they sense then is ignored.
    """
    env, _ = begin(2, lateral_line=LateralLine(num_samples=4, features=("t",)))
    advance = env.solver.advance_
    monkeypatch.setattr(env.solver, "advance_", lambda num, rows: advance(num))
    place_nose(env, 1, x)
    after = act(env, CRUISE, CRUISE)
    assert after["terminated"].squeeze(-1).tolist() == [False, True]
    times = after["lateral_line"][:, :, 0, 0]
    swims, ends = times.diff(dim=1)
    assert (swims > 0).all()
    assert (ends[0] > 0).item() == (not is_first) and ends[-1] == 0
    ended_T = env.now["age"][1].item() / env.task.scales.period
    assert not is_first or times[1, 0].item() == pytest.approx(ended_T)


def test_memory_persists_between_decisions_and_restarts_with_its_row() -> None:
    env, _ = begin(2)
    assert act(env, ACCELERATE, DECELERATE)["gear"].squeeze(-1).tolist() == [2, 0]
    kept = env.now.clone()
    reset_rows(env, True, False)
    assert env.now["gear"].tolist() == [1, 0]
    assert (env.now[1] == kept[1]).all()
    assert act(env, CRUISE, ACCELERATE)["gear"].squeeze(-1).tolist() == [1, 1]


def test_resting_row_keeps_its_last_signal(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a GPU its flow continues, and may diverge."""
    env, before = begin(2)
    sample, lost = env.solver.sample, torch.tensor([0.0, torch.nan])[:, None]
    monkeypatch.setattr(
        env.solver, "sample", lambda at: (sample(at)[0] + lost, sample(at)[1] + lost[..., None])
    )
    env.is_resting = torch.tensor([False, True])
    after = act(env, CRUISE, CRUISE)
    assert torch.equal(after["lateral_line"][1], before["lateral_line"][1])
    assert after["observation"].isfinite().all()


def test_steering_turns_the_fish_towards_the_centreline() -> None:
    env, _ = begin(steering=PIDSteering(gain=0.5, integral_gain=0.0), start_y_bl=(0.1, 0.1))
    act(env, CRUISE)
    assert env.now["heading"].item() == pytest.approx(pi + 0.05, abs=1e-6)
    assert env.task.report(env.now)["angle_of_attack"].item() == pytest.approx(0.05, abs=1e-6)


def test_work_has_its_unit_and_costs_reward_once() -> None:
    env, _ = begin(reward_terms=StationReward(rim_weight=0.0))
    unit = (20 * 20 / env.task.scales.period) ** 2  # rho L^2 (L / T)^2
    done = {"work": 0.3, "positive_work": 0.5, "lateral_work": 0.2, "torque_work": -0.1}
    for name, share in done.items():
        getattr(env.solver.body, name).fill_(share * unit)
    first, second = act(env, CRUISE), act(env, CRUISE)
    assert {name: first[name].item() for name in done} == pytest.approx(done)
    assert first["reward"].item() == pytest.approx(1.0 + 0.1 * (1.0 - 0.3 / 0.1))
    assert second["reward"].item() == pytest.approx(1.0 + 0.1)  # nothing was done since


@pytest.mark.parametrize(
    ("x", "y"), [(0.6, 0.0), (2.0, 0.93), (2.0, -0.93)], ids=["near", "above", "below"]
)
def test_danger_area_terminates_with_a_penalty(x: float, y: float) -> None:
    steering = PIDSteering(gain=0.0, integral_gain=0.0)
    env, _ = begin(steering=steering, reward_terms=StationReward(rim_weight=0.0))
    place_nose(env, 0, x, y)
    if y:
        env.solver.body.heading.add_(-0.4 if y > 0 else 0.4)  # and outwards
    after = act(env, CRUISE)
    assert after["terminated"].all()
    assert after["reward"].item() < 1.2 - 5.0


def test_starts_of_other_flows_and_phases_are_refused() -> None:
    task = make_task()
    for key, value, allowed in (("flow_index", 3, "0 to 2"), ("wake_phase", 1.0, r"\[0, 1\)")):
        starts = task.sample_starts(1, torch.Generator().manual_seed(0))
        starts[key].fill_(value)
        with pytest.raises(ValueError, match=rf"\['{key}'\] = \[{value}\]: allowed is {allowed}"):
            task.check_starts(starts)
