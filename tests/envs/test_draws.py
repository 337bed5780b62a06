"""Random numbers that depend on seed, row and episode alone."""

import torch

from fishrl.envs.draws import draw_uniform, scramble


def test_scramble_matches_splitmix64() -> None:
    """Seed 0: 0xe220a8397b1dcdaf, 0x6e789e6aa1b965f4, as the reference implementation by Vigna."""
    state = torch.tensor([1, 2]) * (0x9E3779B97F4A7C15 - (1 << 64))
    expected = [0xE220A8397B1DCDAF, 0x6E789E6AA1B965F4]
    assert [x % (1 << 64) for x in scramble(state).tolist()] == expected


def test_draws_are_uniform_over_rows_and_episodes() -> None:
    many, one = torch.arange(4000), torch.zeros(4000, dtype=torch.int64)
    for row, episode in ((many, one), (one, many)):
        u = draw_uniform(3, row, episode, 2)
        assert ((u >= 0) & (u < 1)).all()
        # 5 standard errors of mean, variance and correlation
        assert (u.mean(0) - 0.5).abs().max() < 5 * 12**-0.5 / 4000**0.5
        assert (u.var(0) - 1 / 12).abs().max() < 5 * (1 / 180) ** 0.5 / 4000**0.5
        assert torch.corrcoef(u.T)[0, 1].abs() < 5 / 4000**0.5
        assert u.unique().numel() == u.numel()


def test_draw_depends_on_seed_row_and_episode_alone() -> None:
    rows = torch.arange(5)
    u = draw_uniform(7, rows, rows * 2, 3)
    for i in range(5):
        assert torch.equal(draw_uniform(7, rows[i : i + 1], rows[i : i + 1] * 2, 3), u[i : i + 1])
    assert not (draw_uniform(8, rows, rows * 2, 3) == u).any()
    assert not (draw_uniform(7, rows, rows * 2 + 1, 3) == u).any()
    assert torch.equal(draw_uniform(7, rows, rows * 2, 1), u[:, :1])
