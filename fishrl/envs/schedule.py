"""When, within an action, the flows are looked at."""

from itertools import pairwise
from typing import NamedTuple


class Stretch(NamedTuple):
    """Steps up to the next look at the flows.

    Attributes:
        num_steps: an even number of steps.
        is_check: whether ends of episodes are looked for after them.
        is_frame: whether a picture is due after them.
        is_sample: whether the series are sampled after them.
        is_last: whether the action is over after them.
    """

    num_steps: int
    is_check: bool
    is_frame: bool
    is_sample: bool
    is_last: bool


def make_schedule(
    num_steps: int, *, checks: int, frames: int = 1, samples: int = 0
) -> list[Stretch]:
    """Divide an action into stretches that end at a check, a frame or a sample, as equal as can be.

    Args:
        num_steps: steps of the action, even.
        checks: how many checks there are, the last at the end.
        frames: how many frames there are, the last at the end.
        samples: how many samples there are, the last at the end; there may be none.

    Raises:
        ValueError: if there are more of any than pairs of steps, or fewer than allowed.
    """
    pairs = num_steps // 2
    for name, count, least in (
        ("checks_per_action", checks, 1),
        ("frames_per_action", frames, 1),
        ("num_samples", samples, 0),
    ):
        if not least <= count <= pairs:
            raise ValueError(
                f"{name} = {count}: must lie in [{least}, {pairs}], as flows advance by two steps "
                f"and an action takes {num_steps}"
            )
    check_ends, frame_ends, sample_ends = (
        {2 * round(pairs * k / count) for k in range(1, count + 1)}
        for count in (checks, frames, samples)
    )
    ends = [0, *sorted(check_ends | frame_ends | sample_ends)]
    return [
        Stretch(
            num_steps=end - start,
            is_check=end in check_ends,
            is_frame=end in frame_ends,
            is_sample=end in sample_ends,
            is_last=end == num_steps,
        )
        for start, end in pairwise(ends)
    ]
