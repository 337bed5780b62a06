"""Draws, sensors, rewards and schedules, by themselves."""

import math

import pytest
import torch

from fishrl.envs.draws import draw_uniform, scramble
from fishrl.envs.rewards import reward_approach
from fishrl.envs.schedule import make_schedule
from fishrl.envs.sensors import compute_bearing_error, compute_clearance, sense_target


def doubles(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


def test_scramble_gives_the_first_numbers_of_splitmix64() -> None:
    """Seed 0: 0xe220a8397b1dcdaf, 0x6e789e6aa1b965f4, as the reference implementation by Vigna."""
    state = torch.tensor([1, 2]) * (0x9E3779B97F4A7C15 - (1 << 64))
    expected = [0xE220A8397B1DCDAF, 0x6E789E6AA1B965F4]
    assert [x % (1 << 64) for x in scramble(state).tolist()] == expected


def test_draws_are_uniform_over_rows_and_over_episodes() -> None:
    many, one = torch.arange(4000), torch.zeros(4000, dtype=torch.int64)
    for row, episode in ((many, one), (one, many)):
        u = draw_uniform(3, row, episode, 2)
        assert ((u >= 0) & (u < 1)).all()
        # 5 standard errors of mean, variance and correlation
        assert (u.mean(0) - 0.5).abs().max() < 5 * 12**-0.5 / 4000**0.5
        assert (u.var(0) - 1 / 12).abs().max() < 5 * (1 / 180) ** 0.5 / 4000**0.5
        assert torch.corrcoef(u.T)[0, 1].abs() < 5 / 4000**0.5
        assert u.unique().numel() == u.numel()


def test_a_draw_depends_on_seed_row_and_episode_and_not_on_the_batch() -> None:
    rows = torch.arange(5)
    u = draw_uniform(7, rows, rows * 2, 3)
    for i in range(5):
        assert torch.equal(draw_uniform(7, rows[i : i + 1], rows[i : i + 1] * 2, 3), u[i : i + 1])
    assert not (draw_uniform(8, rows, rows * 2, 3) == u).any()
    assert not (draw_uniform(7, rows, rows * 2 + 1, 3) == u).any()
    assert torch.equal(draw_uniform(7, rows, rows * 2, 1), u[:, :1])


@pytest.mark.parametrize(
    ("heading", "away", "expected"),
    [
        (0.0, (1.0, 1.0), math.pi / 4),
        (math.pi, (-1.0, -1.0), math.pi / 4),  # faces -x: left is -y
        (math.pi, (-1.0, 1.0), -math.pi / 4),
        (0.0, (0.0, -2.0), -math.pi / 2),
        (0.0, (-1.0, 0.0), math.pi),
        (0.0, (-1.0, -1.0), -3 * math.pi / 4),
        (7.5 * math.pi, (-1.0, 0.0), -math.pi / 2),  # several turns later
        (1.0, (0.0, 0.0), 0.0),
    ],
)
def test_the_bearing_error_is_positive_to_the_left_of_the_nose(
    heading: float, away: tuple[float, float], expected: float
) -> None:
    error = compute_bearing_error(doubles(heading), doubles(*away)[None])
    assert float(error) == pytest.approx(expected, abs=1e-12)


def test_the_bearing_error_equals_atan2_and_stays_within_half_a_turn() -> None:
    generator = torch.Generator().manual_seed(0)
    heading = 20.0 * torch.randn(2000, generator=generator, dtype=torch.float64)
    away = torch.randn(2000, 2, generator=generator, dtype=torch.float64)
    error = compute_bearing_error(heading, away)
    difference = torch.atan2(away[:, 1], away[:, 0]) - heading - error
    assert (difference / (2 * math.pi) - (difference / (2 * math.pi)).round()).abs().max() < 1e-14
    assert ((error > -math.pi) & (error <= math.pi)).all()


def test_the_target_is_sensed_alike_in_any_batch() -> None:
    generator = torch.Generator().manual_seed(1)
    head, target = 100 * torch.rand(2, 257, 2, generator=generator, dtype=torch.float64)
    heading = 7 * torch.rand(257, generator=generator, dtype=torch.float64)
    together = sense_target(head, heading, target, body_length=20)
    alone = torch.cat(
        [
            sense_target(h[None], a[None], t[None], body_length=20)
            for h, a, t in zip(head, heading, target, strict=True)
        ]
    )
    assert torch.equal(together, alone)


def test_the_target_is_sensed_in_body_lengths_from_the_head() -> None:
    sensed = sense_target(
        doubles(100.0, 50.0)[None], doubles(math.pi), doubles(40.0, 130.0)[None], body_length=20
    )
    expected = doubles(-3.0, 4.0, 5.0, -math.atan2(4.0, 3.0))
    torch.testing.assert_close(sensed[0], expected, atol=1e-12, rtol=0)


def test_clearance_is_the_least_distance_from_any_edge_and_negative_outside() -> None:
    outlines = doubles(
        *(5.0, 20.0, 8.0, 21.0), *(50.0, 20.0, 96.0, 21.0), *(50.0, 46.0, 60.0, 20.0),
        *(50.0, 2.0, 60.0, 20.0), *(-1.0, 20.0, 60.0, 20.0),
    ).view(5, 2, 2)  # fmt: skip
    clearance = compute_clearance(outlines, width=100, height=50)
    assert clearance.tolist() == [5.0, 3.0, 3.0, 2.0, -1.0]


def test_approach_is_rewarded_if_distance_or_bearing_error_shrinks() -> None:
    before, after = doubles(2.0, 2.0, 2.0, 2.0, 2.0), doubles(1.9, 2.1, 2.1, 2.0, 2.0)
    old_error, error = doubles(0.1, -0.5, 0.5, 0.2, 0.2), doubles(0.3, 0.4, -0.6, 0.2, -0.1)
    reward = reward_approach(before, after, old_error, error)
    assert reward.tolist() == [1.0, 1.0, -1.0, -1.0, 1.0]


@pytest.mark.parametrize(("num_steps", "checks", "frames"), [(562, 20, 8), (106, 7, 1), (6, 3, 3)])
def test_a_schedule_fills_the_action_with_even_stretches(
    num_steps: int, checks: int, frames: int
) -> None:
    stretches = make_schedule(num_steps, checks=checks, frames=frames)
    assert sum(s.num_steps for s in stretches) == num_steps
    assert all(s.num_steps > 0 and s.num_steps % 2 == 0 for s in stretches)
    assert sum(s.is_check for s in stretches) == checks
    assert sum(s.is_frame for s in stretches) == frames
    assert [s.is_last for s in stretches] == [False] * (len(stretches) - 1) + [True]
    assert stretches[-1].is_check and stretches[-1].is_frame
    between = make_schedule(num_steps, checks=checks, frames=1)
    assert {s.num_steps // 2 - num_steps // 2 // checks for s in between} <= {0, 1}


@pytest.mark.parametrize(("checks", "frames"), [(0, 1), (1, 4)])
def test_a_schedule_has_no_more_looks_than_pairs_of_steps(checks: int, frames: int) -> None:
    with pytest.raises(ValueError, match=r"must lie in \[1, 3\]"):
        make_schedule(6, checks=checks, frames=frames)
