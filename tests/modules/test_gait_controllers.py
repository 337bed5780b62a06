"""Frequency controllers and the actions for a commanded frequency."""

import pytest
import torch
from tensordict import TensorDict

from fishrl.modules import PID, FixedFrequency, GaitPolicy, KeepCourse, bang_bang

ROWS = ((0.5, 1.0, 1.5), (0.6, 1.2, 1.8))


def see(
    x: list[float], *, change: float = 0.0, gear: int = 1, flow: int = 0, is_init: bool = False
) -> TensorDict:
    """Return the observations of fish at distances ``x``."""
    num = len(x)
    place, drift = torch.zeros(2, num, 2, dtype=torch.float64)
    place[:, 0], drift[:, 0] = torch.tensor(x), change
    return TensorDict(
        {
            "place": place,
            "drift": drift,
            "action_mask": torch.ones(num, 3, dtype=torch.bool),
            "gear": torch.full((num, 1), gear),
            "flow_index": torch.full((num, 1), flow),
            "is_init": torch.full((num, 1), is_init),
        },
        [num],
    )


def act(policy: GaitPolicy, seen: TensorDict) -> list[int]:
    return policy(seen)["action"].tolist()


def test_fixed_frequency_is_reached_gear_by_gear() -> None:
    for frequency, actions in ((1.4, [2, 2, 1]), (0.0, [1, 0, 0])):
        policy = GaitPolicy(controller=FixedFrequency(frequency), rows=ROWS)
        assert [act(policy, see([1.5], gear=gear))[0] for gear in range(3)] == actions
    policy = GaitPolicy(controller=FixedFrequency((0.5, 1.8)), rows=ROWS)
    assert [act(policy, see([1.5], flow=flow)) for flow in (0, 1)] == [[0], [2]]
    between = see([1.5]).set("flow_index", torch.tensor([[0.8]]))  # the mean of uncertain labels
    assert act(policy, between) == [2]


def test_direct_actions_are_nearest_and_continuous_ones_clamped() -> None:
    policy = GaitPolicy(controller=FixedFrequency(1.2), rows=ROWS[:1], is_direct=True)
    assert act(policy, see([1.5, 3.0], gear=0, flow=1)) == [1, 1]
    asked = [0.0, 0.5, 1.0, 9.0]
    policy = GaitPolicy(controller=FixedFrequency(asked), rows=[(0.5, 1.5)], num_numbers=1)
    given = [policy(see([1.5], flow=flow))["action"].tolist() for flow in range(4)]
    assert given == [[[-1.0]], [[-1.0]], [[0.0]], [[1.0]]]


def test_bang_bang_accelerates_behind_station() -> None:
    policy = GaitPolicy(controller=bang_bang, rows=ROWS)
    assert act(policy, see([2.0, 2.2])) == [0, 2]
    assert act(policy, see([1.9], gear=0)) == [1]


def test_pid_beats_faster_behind_station_and_drifting_back() -> None:
    controller = PID(station_bl=2.0, frequency=1.0, gain=1.0, damping=2.0)
    policy = GaitPolicy(controller=controller, rows=ROWS)
    assert act(policy, see([1.4, 2.0, 2.6])) == [0, 1, 2]
    assert [act(policy, see([2.0], change=change)) for change in (0.3, -0.3)] == [[2], [0]]
    controller = PID(station_bl=torch.tensor([1.4, 2.0, 2.6]), frequency=1.0, gain=1.0)
    assert act(GaitPolicy(controller=controller, rows=ROWS), see([2.0, 2.0, 2.0])) == [2, 1, 0]


def test_integral_is_bounded_and_restarts_with_each_episode() -> None:
    controller = PID(station_bl=2.0, gain=0.0, damping=0.0, integral_gain=1.0, max_sum=0.6)
    flow = torch.zeros(1, dtype=torch.int64)

    def want(is_init: bool = False) -> float:
        return controller(see([2.25], is_init=is_init), flow).item()

    assert [want(True), want(), want(), want()] == pytest.approx([1.25, 1.5, 1.6, 1.6])
    assert want(True) == pytest.approx(1.25)


@pytest.mark.parametrize("num_numbers", [None, 2])
def test_course_keeping_bends_towards_centreline_and_upstream(num_numbers: int | None) -> None:
    rows = [(0.5, 1.5)] if num_numbers else ROWS
    policy = GaitPolicy(
        controller=FixedFrequency(1.0), course=KeepCourse(), rows=rows, num_numbers=num_numbers
    )
    seen = see([1.5] * 5)
    seen["place"][:, 1] = torch.tensor([0.0, 1.0, -1.0, 0.0, 0.0])  # upstream is -x, right is +y
    seen["facing"] = torch.tensor([0.0, 0.0, 0.0, 0.9, 0.0])[:, None].double()  # to the left
    seen["yaw_rate"] = torch.tensor([0.0, 0.0, 0.0, 0.0, -9.0])[:, None].double()
    bends = [0, 1, -1, -1, 1]
    given = policy(seen)["action"]
    if num_numbers:
        assert given.tolist() == [[bend, 0.0] for bend in bends]
    else:
        assert given.tolist() == [3 * 1 + 1 + bend for bend in bends]
