"""When, within an action, the flows are looked at."""

from itertools import pairwise
from typing import NamedTuple


class Stretch(NamedTuple):
    """Steps up to the next look at the flows.

    Attributes:
        num_steps: an even number of steps.
        is_check: whether ends of episodes are looked for after them.
        is_frame: whether a picture is due after them.
        is_last: whether the action is over after them.
    """

    num_steps: int
    is_check: bool
    is_frame: bool
    is_last: bool


def make_schedule(num_steps: int, *, checks: int, frames: int) -> list[Stretch]:
    """Divide an action into stretches that end at a check, a frame or both, as equal as can be.

    Args:
        num_steps: steps of the action, even.
        checks: how many checks there are, the last at the end.
        frames: how many frames there are, the last at the end.

    Raises:
        ValueError: if there are more of either than pairs of steps, or fewer than one.
    """
    pairs = num_steps // 2
    for name, count in (("checks_per_action", checks), ("frames_per_action", frames)):
        if not 1 <= count <= pairs:
            raise ValueError(
                f"{name} = {count}: must lie in [1, {pairs}], as flows advance by two steps and an "
                f"action takes {num_steps}"
            )
    check_ends, frame_ends = (
        {2 * round(pairs * k / count) for k in range(1, count + 1)} for count in (checks, frames)
    )
    ends = [0, *sorted(check_ends | frame_ends)]
    return [
        Stretch(end - start, end in check_ends, end in frame_ends, end == num_steps)
        for start, end in pairwise(ends)
    ]
