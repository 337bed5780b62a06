"""The schedule of checks, frames and samples within an action."""

from typing import NamedTuple


class Stop(NamedTuple):
    """A moment of an action at which something is due."""

    step: int  #: steps since the beginning of the action, even
    is_check: bool  #: check for termination
    is_frame: bool  #: call ``on_frame``
    is_sample: bool  #: record sensor samples
    is_last: bool  #: the action ends


def make_schedule(num_steps: int, *, checks: int, frames: int = 1, samples: int = 0) -> list[Stop]:
    """Return the stops of an action: evenly spaced checks, frames and samples.

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
    check_at, frame_at, sample_at = (
        {2 * round(pairs * k / count) for k in range(1, count + 1)}
        for count in (checks, frames, samples)
    )
    return [
        Stop(step, step in check_at, step in frame_at, step in sample_at, step == num_steps)
        for step in sorted(check_at | frame_at | sample_at)
    ]
