"""The schedule of checks, frames and samples within an action."""

from itertools import pairwise
from typing import NamedTuple


class Stretch(NamedTuple):
    """Steps up to the next event."""

    num_steps: int  #: number of steps, even
    is_check: bool  #: check for termination after them
    is_frame: bool  #: call ``on_frame`` after them
    is_sample: bool  #: record sensor samples after them
    is_last: bool  #: the action ends after them


def make_schedule(
    num_steps: int, *, checks: int, frames: int = 1, samples: int = 0
) -> list[Stretch]:
    """Divide an action into stretches that end at evenly spaced checks, frames or samples.

    Args:
        num_steps: steps of the action, even.
        checks: number of checks, the last at the end.
        frames: number of frames, the last at the end.
        samples: number of samples, the last at the end; may be 0.

    Raises:
        ValueError: if a number exceeds the number of pairs of steps, or is too small.
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
