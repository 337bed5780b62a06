"""Stretches of an action between checks and frames."""

import pytest

from fishrl.envs.schedule import make_schedule


@pytest.mark.parametrize(("num_steps", "checks", "frames"), [(562, 20, 8), (106, 7, 1), (6, 3, 3)])
def test_schedule_fills_the_action_with_even_stretches(
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


def test_too_many_checks_or_frames_are_refused() -> None:
    for checks, frames in ((0, 1), (1, 4)):
        with pytest.raises(ValueError, match=r"must lie in \[1, 3\]"):
            make_schedule(6, checks=checks, frames=frames)
