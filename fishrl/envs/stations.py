"""Safe area and weights of the reward for holding station."""

import torch
from pydantic import NonNegativeFloat, PositiveFloat
from torch import Tensor

from fishrl.settings import Settings


class SafeArea(Settings):
    """A rectangle surrounded by the danger area.

    Positions are (x downstream, y) from the middle of the obstacle's flat side, in body lengths.

    Args:
        near_bl: smallest x; nearer, suction in the wake draws the fish to the obstacle.
        far_bl: largest x; farther, the stream sweeps the fish away.
        aside_bl: largest distance from the centreline.
        rim_bl: width of the inner strip with a penalty.
    """

    near_bl: float = 0.4
    far_bl: float = 4.0
    aside_bl: PositiveFloat = 1.0
    rim_bl: NonNegativeFloat = 0.25

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.near_bl < self.far_bl:
            raise ValueError(f"near_bl = {self.near_bl}: must be less than far_bl = {self.far_bl}")

    def measure_margin(self, place: Tensor) -> Tensor:
        """Return the distance ``[B]`` of positions ``[B, 2]`` from the danger area, in L."""
        x, y = place.unbind(-1)
        gaps = torch.stack((x - self.near_bl, self.far_bl - x, self.aside_bl - y.abs()))
        return gaps.amin(0)

    def name_sides(self, place: Tensor) -> dict[str, Tensor]:
        """Return by words whether positions ``[B, 2]`` are in the danger area there, ``[B]``."""
        x, y = place.unbind(-1)
        return {
            "drawn too near the obstacle": x <= self.near_bl,
            "swept downstream out of the safe area": x >= self.far_bl,
            "left the safe area at the side": y.abs() >= self.aside_bl,
        }

    def check_starts(self, place: Tensor) -> None:
        """Raise ValueError for the first start whose nose, at ``place`` ``[E, 2]``, is outside."""
        is_wrong = ~(self.measure_margin(place) > 0.0)
        if is_wrong.any():
            i = int(is_wrong.int().argmax())
            x, y = place[i].tolist()
            raise ValueError(
                f"start {i}, nose at ({x:.2f}, {y:.2f}) L from the disc, is in the danger area: "
                f"allowed is x in ({self.near_bl}, {self.far_bl}), y within {self.aside_bl} of 0; "
                "move it (start_x_bl, start_y_bl), or widen safe_area"
            )


class StationReward(Settings):
    """Weights of r1 to r4 of the paper's Task 2, see ``KarmanGait.reward``.

    Args:
        drift_limit_bl: downstream drift in one interval beyond which r1, ``hold``, is -1 instead of
            +1; a quarter of the paper's 20 nodes, for a quarter of its interval.
        work_weight: weight of r2, ``work`` = work_weight (1 - work / work_reference).
        work_reference: work of an interval in rho L^2 (L / T)^2; corresponds to 0.4 per T, twice
            the work of a typical gait.
        danger_penalty: r3, ``danger``, subtracted on entering the danger area or touching an edge.
        rim_weight: r4, ``rim``, subtracted per body length inside the rim; the paper's
            (L_max - L_dis) / 10 in nodes.
    """

    drift_limit_bl: float = 0.05
    work_weight: float = 0.1
    work_reference: PositiveFloat = 0.1
    danger_penalty: float = 5.0
    rim_weight: float = 10.0
