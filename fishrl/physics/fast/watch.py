"""What becomes of flows as they advance: diverged, left by a body, or with bodies that overlap."""

import logging
from collections.abc import Sequence

import torch
from torch import Tensor

from fishrl.physics.flow import FlowConfig
from fishrl.physics.placement import describe_inside, find_overlaps, lies_inside

logger = logging.getLogger(__name__)

#: Most steps between two looks at several bodies: the fastest moves by a few nodes in them, and
#: a look costs as much as several steps.
_LOOK_STEPS = 40
_ADVICE = (
    "place them with reset_, enlarge Patch(size=..., within=...), give bodies that meet one Patch, "
    "or take fewer levels, whose patches move 2^(2 - levels) nodes per step at most"
)


class Watch:
    """Notices what is lost in a batch of flows.

    Attributes:
        overlaps: ``[B]`` bool, whether bodies that ``look_`` saw since ``forget_`` overlapped.
        is_idle: whether a fish has got no frequency.
    """

    def __init__(self, config: FlowConfig, num_envs: int, device: torch.device) -> None:
        self._config = config
        self._was_lost = torch.zeros(num_envs, dtype=torch.bool)
        self.overlaps = self._was_lost.to(device, copy=True)
        self._can_overlap = len(config.bodies) > 1 and not config.is_still
        # a look launches hundreds of operators: on a GPU only where somebody asks
        self._looks_between = self._can_overlap and device.type == "cpu"
        self.is_idle = False

    def split(self, num_steps: int, unit: int) -> list[int]:
        """Return numbers of steps, multiples of ``unit``, with a look between them.

        Logs, once, that a fish is idle.
        """
        if self.is_idle:
            self.is_idle = False
            logger.warning(
                "the fish does not beat: give InPlaceSolver(frequency=1 / T), T steps per beat, or "
                "0.0 for one that glides"
            )
        stride = unit * -(-_LOOK_STEPS // unit) if self._looks_between else max(1, num_steps)
        return [min(stride, num_steps - done) for done in range(0, max(1, num_steps), stride)]

    def look_(self, outlines: Sequence[Tensor]) -> None:
        """Remember which of the bodies with these outlines ``[B, N, 2]`` overlap."""
        if self._can_overlap:
            self.overlaps |= find_overlaps(outlines)

    def forget_(self, rows: Tensor) -> None:
        """Begin again with flows ``[B]``."""
        self.overlaps &= ~rows
        if rows.device.type == "cpu":
            self._was_lost &= ~rows

    def report(self, outlines: Sequence[Tensor], is_lost: Tensor, are_held: Tensor) -> None:
        """Log flows ``[B]`` that are lost since the last time, as they are not finite.

        In those that ``are_held``, patches hold their bodies, whose outlines are ``[B, N, 2]``
        each, and do not overlap.
        """
        self.look_(outlines)
        has_left = torch.zeros_like(is_lost)
        for outline in outlines:
            is_known = outline.isfinite().flatten(1).all(-1)  # not a free body's in a lost flow
            has_left |= is_known & ~lies_inside(outline, self._config)
        was_lost, self._was_lost = self._was_lost, is_lost | has_left | self.overlaps | ~are_held
        new = self._was_lost & ~was_lost
        meet = new & self.overlaps & ~has_left
        outrun = new & ~(is_lost | has_left | self.overlaps)
        advice = "lower stream_speed, raise tau, or keep free bodies from edges and each other"
        for flows, problem in (
            (new & has_left, f"lose a body at an edge: {describe_inside(self._config)}"),
            (meet, "have bodies that overlap: end an episode before they touch"),
            (outrun, f"have bodies outside their patches, or patches that overlap: {_ADVICE}"),
            (new & ~has_left & ~meet & ~outrun, f"have diverged: {advice}"),
        ):
            if flows.any():
                logger.warning("flows %s %s", flows.nonzero()[:, 0].tolist(), problem)
