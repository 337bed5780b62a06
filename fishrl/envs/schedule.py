"""The schedule of checks, frames and samples within an action."""

from typing import NamedTuple


class Stop(NamedTuple):
    """A moment of an action at which something is due."""

    step: int  #: steps since the beginning of the action, a multiple of those advanced at once
    is_check: bool  #: check for termination
    is_frame: bool  #: call ``on_frame``
    is_sample: bool  #: record sensor samples
    is_last: bool  #: the action ends


def make_schedule(
    num_steps: int, *, checks: int, frames: int = 1, samples: int = 0, unit: int = 2
) -> list[Stop]:
    """Return the stops of an action: evenly spaced checks, frames and samples.

    Args:
        num_steps: steps of the action, a multiple of ``unit``.
        checks: number of checks, the last at the end.
        frames: number of frames, the last at the end.
        samples: number of samples, the last at the end; may be 0.
        unit: steps that flows advance at once; two, and with levels more.

    Raises:
        ValueError: if a number exceeds the number of such units, or is too small.
    """
    units = num_steps // unit
    for name, count, least in (
        ("checks_per_action", checks, 1),
        ("frames_per_action", frames, 1),
        ("num_samples", samples, 0),
    ):
        if not least <= count <= units:
            raise ValueError(
                f"{name} = {count}: must lie in [{least}, {units}], as flows advance by {unit} "
                f"steps and an action takes {num_steps}"
            )
    check_at, frame_at, sample_at = (
        {unit * round(units * k / count) for k in range(1, count + 1)}
        for count in (checks, frames, samples)
    )
    return [
        Stop(step, step in check_at, step in frame_at, step in sample_at, step == num_steps)
        for step in sorted(check_at | frame_at | sample_at)
    ]
