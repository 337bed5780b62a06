"""Times and speeds of changes of a stream, and their effect on a task."""

from typing import Any

import pytest
import torch

from fishrl.envs import KarmanGait
from fishrl.envs.changes import StreamChanges, StreamSteps, StreamSwitches, StreamWalk
from fishrl.envs.streams import Stream
from tests.envs.conftest import SMALL, act, make_flows, read_flows
from tests.envs.test_real_wake import STREAM, TINY, task  # noqa: F401 - a fixture

KEYS = torch.arange(500)
FIRST = torch.tensor([1.0, 1.25, 1.5]).double().repeat(167)[:500]


def make_task(changes: StreamChanges, **arguments: Any) -> KarmanGait:
    settings = SMALL | {"wall_margin_bl": 0.25, "time_limit": 40} | arguments
    return KarmanGait(**settings, stream=Stream(changes=changes))


def test_switches_are_uniform_over_the_other_speeds() -> None:
    switches = StreamSwitches(interval_T=2.0)
    assert switches.list_times(3) == [2.0, 4.0, 6.0]
    assert switches.draw_speeds(FIRST, KEYS, 8.0).shape == (500, 3)
    speeds = switches.draw_speeds(FIRST, KEYS, 9.0)
    path = torch.cat((FIRST[:, None], speeds), 1)
    assert (path.diff(dim=1) != 0.0).all()
    ends = torch.unique(path[:, :2], dim=0, return_counts=True)[1] / 500
    assert len(ends) == 6 and ((ends - 1 / 6).abs() < 0.05).all()  # three standard deviations
    assert torch.equal(switches.draw_speeds(FIRST[7:8], KEYS[7:8], 9.0), speeds[7:8])


def test_walk_stays_within_its_limits_and_step() -> None:
    walk = StreamWalk(interval_T=1.0, step_bl=0.3)
    path = torch.cat((FIRST[:, None], walk.draw_speeds(FIRST, KEYS, 51.0)), 1)
    assert path.shape == (500, 51)
    assert 0.9 <= path.min() < 0.91 and 1.59 < path.max() <= 1.6
    steps = path.diff(dim=1).abs()
    assert 0.29 < steps.max() <= 0.3
    is_inside = ((path - 1.25).abs() < 0.05)[:, :-1]  # where no limit can be reached
    assert steps[is_inside].mean() == pytest.approx(0.15, abs=0.01)


def test_steps_are_the_same_in_every_episode() -> None:
    steps = StreamSteps(times_T=(3.0, 5.0), speeds_bl=(1.5, 0.9), ramp_T=2.0)
    assert steps.draw_speeds(FIRST[:3], KEYS[:3], 1.0).tolist() == [[1.5, 0.9]] * 3
    assert steps.list_times(2) == [3.0, 5.0]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: StreamSteps(times_T=(5.0, 3.0), speeds_bl=(1.0, 1.5)), "times must rise"),
        (lambda: StreamSteps(times_T=(3.0, 3.5), speeds_bl=(1.0, 1.5)), "at least ramp_T"),
        (lambda: StreamSteps(times_T=(3.0,), speeds_bl=(1.0, 1.5)), "one speed for each time"),
        (lambda: StreamSwitches(interval_T=0.5), "must end before the next"),
        (lambda: StreamSwitches(speeds_bl=(1.0, 1.0)), "must differ"),
        (lambda: StreamWalk(low_bl=1.5, high_bl=1.0), "high_bl must exceed low_bl"),
        (lambda: make_task(StreamWalk(high_bl=3.0)), r"to 3 L/T: allowed .* up to 2\.\d+ L/T"),
    ],
)
def test_invalid_settings_are_refused(make: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()


def test_changes_affect_neither_other_starts_nor_units() -> None:
    changing = make_task(StreamSwitches(interval_T=2.0))
    steady = KarmanGait(**SMALL | {"wall_margin_bl": 0.25})
    assert changing.scales == steady.scales
    draw = [each.sample_starts(5, torch.Generator().manual_seed(0)) for each in (changing, steady)]
    assert draw[0]["stream_speeds"].shape == (5, 4)  # 40 decisions are 10 T, a change each 2 T
    assert (draw[0].exclude("stream_speeds") == draw[1]).all()
    draw[0]["stream_speeds"][1, 0] = torch.nan
    with pytest.raises(ValueError, match=r"starts\['stream_speeds'\] reaches"):
        changing.check_starts(draw[0])


@pytest.mark.usefixtures("kinematic")
def test_each_row_follows_its_own_changes() -> None:
    changes = StreamSteps(times_T=(0.4, 1.6), speeds_bl=(1.5, 1.0), ramp_T=0.4)
    stepping = make_task(changes, control_interval_T=0.5, checks_per_action=13)
    starts = stepping.sample_starts(2, torch.Generator().manual_seed(0))
    starts["flow_index"] = torch.tensor([0, 1])
    starts["stream_speeds"][1] = torch.tensor([1.1, 1.6])
    env = make_flows(stepping, 2, starts=starts)
    env.reset()
    speeds, names = [], []
    for _ in range(5):
        after = act(env, 1, 1)
        speeds.append(after["stream_speed"].squeeze(-1))
        names.append(after["flow_index"].squeeze(-1).tolist())
    # they change within the first decision at or after 0.4 and 1.6 T
    expected = [[1.0, 1.25], [1.5, 1.1], [1.5, 1.1], [1.5, 1.1], [1.0, 1.6]]
    torch.testing.assert_close(torch.stack(speeds), torch.tensor(expected).double())
    assert names == [[0, 1], [2, 0], [2, 0], [2, 0], [0, 2]]


def test_stream_changes_smoothly_and_continues_exactly_within_a_change(
    task: KarmanGait,  # noqa: F811 - the fixture
) -> None:
    changes = StreamSteps(times_T=(0.2,), speeds_bl=(1.5,), ramp_T=0.5)
    stream = Stream(**STREAM, changes=changes)
    changing = KarmanGait(**TINY | {"start_x_bl": (0.35, 0.4)}, stream=stream)
    changing.__dict__["wakes"] = task.wakes
    starts = changing.sample_starts(1, torch.Generator().manual_seed(4))
    starts["flow_index"] = torch.tensor([0])
    env, other = (make_flows(changing, 1, starts=starts) for _ in range(2))
    env.reset()
    speeds = [act(env, 1)["stream_speed"].item() for _ in range(2)]
    other.load_state_dict(env.state_dict())
    speeds += [act(each, 1)["stream_speed"].item() for each in (env, other)]
    assert speeds == pytest.approx([1.0, 1.25, 1.5, 1.5], abs=0.01)
    for name, value in read_flows(env).items():
        assert torch.equal(read_flows(other)[name], value), name
