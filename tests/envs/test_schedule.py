"""Stops of an action for checks and frames."""

from itertools import pairwise

import pytest

from fishrl.envs.schedule import make_schedule


@pytest.mark.parametrize(("num_steps", "checks", "frames"), [(562, 20, 8), (106, 7, 1), (6, 3, 3)])
def test_stops_are_evenly_spaced_in_an_action(num_steps: int, checks: int, frames: int) -> None:
    stops = make_schedule(num_steps, checks=checks, frames=frames)
    steps = [stop.step for stop in stops]
    assert steps == sorted(set(steps)) and steps[0] > 0 and not any(step % 2 for step in steps)
    assert sum(stop.is_check for stop in stops) == checks
    assert sum(stop.is_frame for stop in stops) == frames
    assert stops[-1] == (num_steps, True, True, False, True)
    assert not any(stop.is_last for stop in stops[:-1])
    alone = [0, *(stop.step for stop in make_schedule(num_steps, checks=checks))]
    pairs = {(after - before) // 2 - num_steps // 2 // checks for before, after in pairwise(alone)}
    assert pairs <= {0, 1}


def test_too_many_checks_or_frames_are_refused() -> None:
    for checks, frames in ((0, 1), (1, 4)):
        with pytest.raises(ValueError, match=r"must lie in \[1, 3\]"):
            make_schedule(6, checks=checks, frames=frames)
