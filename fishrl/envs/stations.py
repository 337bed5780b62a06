"""Where a fish that holds its station may be, and what it earns there."""

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True, kw_only=True)
class SafeArea:
    """The rectangle outside which lies the danger area.

    Places are (x downstream, y) from the middle of the obstacle's flat side, in body lengths.

    Args:
        near_bl: least x: nearer, the wake sucks the fish to the obstacle.
        far_bl: largest x: farther, it is swept away.
        aside_bl: largest distance from the middle line.
        rim_bl: width of the strip along its border where it is already punished.
    """

    near_bl: float = 0.4
    far_bl: float = 4.0
    aside_bl: float = 1.0
    rim_bl: float = 0.25

    def __post_init__(self) -> None:
        """Refuse an area with nothing in it."""
        if not self.near_bl < self.far_bl or self.aside_bl <= 0.0 or self.rim_bl < 0.0:
            raise ValueError(
                f"near_bl = {self.near_bl}, far_bl = {self.far_bl}, aside_bl = {self.aside_bl}, "
                f"rim_bl = {self.rim_bl}: allowed is near < far, aside > 0, rim >= 0"
            )

    def measure_margin(self, place: Tensor) -> Tensor:
        """Return the distance ``[B]`` of places ``[B, 2]`` from the danger area, body lengths."""
        x, y = place.unbind(-1)
        gaps = torch.stack((x - self.near_bl, self.far_bl - x, self.aside_bl - y.abs()))
        return gaps.amin(0)


@dataclass(frozen=True, kw_only=True)
class StationReward:
    """Reward for holding a station cheaply: r1 to r4 of the paper's Task 2.

    Args:
        drift_limit_bl: way downstream in one interval beyond which r1 is -1 instead of +1;
            a quarter of the paper's 20 nodes, for a quarter of its interval.
        work_weight: r2 = work_weight (1 - work of the interval / work_reference).
        work_reference: in rho L^2 (L / T)^2, of an interval; 0.4 per T, twice what a gait costs.
        danger_penalty: r3, taken off on entering the danger area or touching an edge.
        rim_weight: r4, taken off per body length that the fish is inside the rim; the paper's
            (L_max - L_dis) / 10 in nodes.
    """

    drift_limit_bl: float = 0.05
    work_weight: float = 0.1
    work_reference: float = 0.1
    danger_penalty: float = 5.0
    rim_weight: float = 10.0

    def __post_init__(self) -> None:
        """Refuse a reference that work cannot be measured by."""
        if self.work_reference <= 0.0:
            raise ValueError(f"work_reference = {self.work_reference}: must be positive")

    def compute(
        self, *, drift: Tensor, work: Tensor, depth: Tensor, is_in_danger: Tensor
    ) -> Tensor:
        """Return the reward ``[B]`` of one interval.

        Args:
            drift: ``[B]`` way downstream, body lengths.
            work: ``[B]`` done by the muscles, rho L^2 (L / T)^2.
            depth: ``[B]`` how far it is inside the rim, body lengths, 0 outside.
            is_in_danger: ``[B]`` bool.
        """
        holds = torch.where(drift > self.drift_limit_bl, -1.0, 1.0)
        saved = self.work_weight * (1.0 - work / self.work_reference)
        return holds + saved - self.rim_weight * depth - self.danger_penalty * is_in_danger
