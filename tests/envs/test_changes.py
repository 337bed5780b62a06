"""Times and speeds of changes of a stream, and their effect on a task."""

from typing import Any

import pytest
import torch

from fishrl.envs import KarmanGait
from fishrl.envs.changes import StreamSwitches
from fishrl.envs.streams import Stream
from tests.envs.conftest import SMALL, act, make_flows
from tests.envs.test_real_wake import STREAM, TINY, task  # noqa: F401 - a fixture

KEYS = torch.arange(500)
FIRST = torch.tensor([1.0, 1.25, 1.5]).double().repeat(167)[:500]


def make_task(changes: StreamSwitches, **arguments: Any) -> KarmanGait:
    settings = SMALL | {"wall_margin_bl": 0.25, "time_limit": 40} | arguments
    return KarmanGait(**settings, stream=Stream(changes=changes))


def test_switches_are_uniform_over_other_speeds() -> None:
    switches = StreamSwitches(interval_T=2.0)
    assert switches.list_times(3) == [2.0, 4.0, 6.0]
    assert switches.draw_speeds(FIRST, KEYS, 8.0).shape == (500, 3)
    speeds = switches.draw_speeds(FIRST, KEYS, 9.0)
    path = torch.cat((FIRST[:, None], speeds), 1)
    assert (path.diff(dim=1) != 0.0).all()
    ends = torch.unique(path[:, :2], dim=0, return_counts=True)[1] / 500
    assert len(ends) == 6 and ((ends - 1 / 6).abs() < 0.05).all()  # three standard deviations
    assert torch.equal(switches.draw_speeds(FIRST[7:8], KEYS[7:8], 9.0), speeds[7:8])


def test_changes_affect_neither_starts_nor_units() -> None:
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
    changes = StreamSwitches(interval_T=0.9, ramp_T=0.4, speeds_bl=(1.0, 1.6))
    stepping = make_task(changes, control_interval_T=0.5, checks_per_action=13)
    starts = stepping.sample_starts(2, torch.Generator().manual_seed(0))
    starts["flow_index"] = torch.tensor([0, 1])
    starts["stream_speeds"][:, :2] = torch.tensor([[1.5, 1.0], [1.1, 1.6]])
    env = make_flows(stepping, 2, starts=starts)
    env.reset()
    speeds, names = [], []
    for _ in range(5):
        after = act(env, 1, 1)
        speeds.append(after["stream_speed"].squeeze(-1))
        names.append(after["flow_index"].squeeze(-1).tolist())
    # they change within the first decision at or after 0.9 and 1.8 T
    expected = [[1.0, 1.25], [1.0, 1.25], [1.5, 1.1], [1.5, 1.1], [1.0, 1.6]]
    torch.testing.assert_close(torch.stack(speeds), torch.tensor(expected).double())
    assert names == [[0, 1], [0, 1], [2, 0], [2, 0], [0, 2]]
