"""The danger area and the reward for holding station."""

import pytest
import torch

from fishrl.envs.stations import SafeArea, StationReward

QUIET = {
    "drift": torch.tensor([0.0]),
    "work": torch.tensor([0.0]),
    "depth": torch.tensor([0.0]),
    "is_in_danger": torch.tensor([False]),
}


def test_margin_is_the_distance_from_the_danger_area() -> None:
    area = SafeArea(near_bl=0.5, far_bl=4.0, aside_bl=1.0)
    places = torch.tensor([[0.7, 0.0], [3.9, 0.1], [2.0, -0.8], [0.4, 0.0], [2.0, 1.3]])
    margins = torch.tensor([0.2, 0.1, 0.2, -0.1, -0.3])
    torch.testing.assert_close(area.measure_margin(places), margins)


@pytest.mark.parametrize(
    ("what", "expected"),
    [
        ({}, 1.0 + 0.1),
        ({"drift": torch.tensor([0.05])}, 1.0 + 0.1),
        ({"drift": torch.tensor([0.06])}, -1.0 + 0.1),
        ({"work": torch.tensor([2.0])}, 1.0),
        ({"work": torch.tensor([3.0])}, 1.0 - 0.05),
        ({"depth": torch.tensor([0.1])}, 1.0 + 0.1 - 1.0),
        ({"is_in_danger": torch.tensor([True])}, 1.0 + 0.1 - 5.0),
    ],
)
def test_reward_terms_add_up_as_in_the_paper(
    what: dict[str, torch.Tensor], expected: float
) -> None:
    reward = StationReward(work_reference=2.0).compute(**QUIET | what)
    assert reward.item() == pytest.approx(expected)
