"""The danger area and the reward for holding station."""

from typing import Any

import pytest
import torch
from tensordict import TensorDict

from fishrl.envs import KarmanGait
from fishrl.envs.control import Bend
from fishrl.envs.stations import SafeArea, StationReward


def test_margin_is_the_distance_from_the_danger_area() -> None:
    area = SafeArea(near_bl=0.5, far_bl=4.0, aside_bl=1.0)
    places = torch.tensor([[0.7, 0.0], [3.9, 0.1], [2.0, -0.8], [0.4, 0.0], [2.0, 1.3]])
    margins = torch.tensor([0.2, 0.1, 0.2, -0.1, -0.3])
    torch.testing.assert_close(area.measure_margin(places), margins)


@pytest.mark.parametrize(
    ("settings", "paid"),
    [({}, "work"), ({"control": Bend(bend_bl=0.1), "wall_margin_bl": 0.4}, "positive_work")],
    ids=["steered", "bending"],
)
def test_reward_terms_add_up_as_in_the_paper(settings: dict[str, Any], paid: str) -> None:
    """One row for each term, and one that drifts no more than it may."""
    task = KarmanGait(reward_terms=StationReward(work_reference=2.0), **settings)
    x = torch.full((7,), 2.0).double()
    x[5], x[6] = task.safe_area.near_bl + 0.15, task.safe_area.near_bl  # 0.1 inside the rim, out
    drift = torch.tensor([0.0, 0.05, 0.06, 0.0, 0.0, 0.0, 0.0])
    now = {
        "place": torch.stack((x, 0.0 * x), -1),
        "drift": drift[:, None].expand(-1, 2),
        paid: torch.tensor([0.0, 0.0, 0.0, 2.0, 3.0, 0.0, 0.0]),
        "clearance": torch.full((7,), 99.0),
    }
    terms = task.reward(TensorDict({paid: torch.zeros(7)}, [7]), TensorDict(now, [7]))
    expected = [1.1, 1.1, -0.9, 1.0, 0.95, 1.1 - 1.0, 1.1 - 2.5 - 5.0]
    assert sum(terms.values()).tolist() == pytest.approx(expected)
