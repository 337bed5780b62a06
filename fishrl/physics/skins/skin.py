"""What every skin has: where its markers lie, which bodies it can carry, and its part of a step."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar, TypeVar

from pydantic import PositiveInt
from torch import Tensor

from fishrl.physics.bodies.outline import BodyConfig, BodyParams
from fishrl.physics.bodies.state import BodyState
from fishrl.physics.collision import Collided
from fishrl.settings import Settings

Body = TypeVar("Body", bound=BodyConfig)


class Skin(Settings, ABC):
    """How bodies and water act on each other.

    A skin of your own is a subclass in a file of its own, with ``exchange``, which the fast step
    calls, too; ``fast.body_parts.make_skin_parts`` registers parts that are faster.
    ``geometry.locate_outline`` places the markers of a body, ``surface.prescribe_surface`` gives
    their velocity, and ``rigid_motion.move_body`` takes the force on them.

    Attributes:
        marker_spacing: distance of a body's markers, nodes, unless the body gives its own.
        spacing_range: smallest and largest mean distance that works.
        margin: distance from the edge nodes that markers must keep to reach none beyond, nodes.
        jumps: whether the flow jumps where a moving skin passes a node, so that gradients miss the
            trend.
        has_water_inside: whether the water inside a body is part of the flow and moves with it, so
            that the body's inertia leaves out what it displaces.
    """

    marker_spacing: ClassVar[float]
    spacing_range: ClassVar[tuple[float, float]]
    margin: ClassVar[float]
    jumps: ClassVar[bool]
    has_water_inside: ClassVar[bool]

    marker_multiple: PositiveInt = 1

    @abstractmethod
    def exchange(
        self,
        water: Collided,
        bodies: Sequence[BodyConfig],
        params: Sequence[BodyParams],
        states: Sequence[BodyState],
    ) -> tuple[list[Tensor], tuple[BodyState, ...]]:
        """Let the water act on all bodies and the bodies on the water, for one readable step.

        Args:
            water: the water after collision, without the external force.
            bodies: configuration of each body.
            params: parameters of each body.
            states: state of each body at the start of the step.

        Returns:
            Nine outgoing populations ``[B, Y, X]``, and the bodies one step later.
        """

    def choose_inset(self, body: BodyConfig) -> float:
        """Return how far inside the outline a body's markers lie, nodes."""
        return 0.0

    def find_least_density(self, body: BodyConfig) -> float:
        """Return the least ``density_ratio`` of a body that the flow moves, for a stable flow."""
        return 0.0

    def fit(self, body: Body) -> Body:
        """Return a body with the marker spacing and inset of this skin, where it has none.

        Raises:
            ValueError: if the body was made for another skin, or this one cannot carry it.
        """
        name, own = type(body).__name__, type(self).__name__
        if body.skin not in ("", own):
            raise ValueError(
                f"{name} was made for skin = {body.skin}(), not for {own}(): give "
                f"FlowConfig(bodies=...) a new {name}(...), not one of another flow"
            )
        spacing, inset = body.marker_spacing, body.inset
        fitted = body
        if not body.skin:
            spacing = self.marker_spacing if spacing is None else spacing
            inset = self.choose_inset(body) if inset is None else inset
            fitted = replace(body, marker_spacing=spacing, inset=inset, skin=own)
            if not body.num_markers:
                count = -(-fitted.num_markers // self.marker_multiple) * self.marker_multiple
                fitted = replace(fitted, num_markers=count)
        low, high = self.spacing_range
        if not low <= fitted.spacing <= high:
            raise ValueError(
                f"{name} with num_markers = {fitted.num_markers}: they would lie "
                f"{fitted.spacing:.2f} nodes apart, allowed is {low} to {high} with skin = "
                f"{own}(); leave out marker_spacing and num_markers, or change the size"
            )
        _ = body.area  # of an outline that runs clockwise
        least = self.find_least_density(fitted)
        if body.motion.free_axes and body.density_ratio < least:
            raise ValueError(
                f"{name} with density_ratio = {body.density_ratio}: must be at least {least:.3g} "
                f"at this size, as a lighter one is unstable with skin = {own}(); give skin = "
                "BounceBack()"
            )
        return fitted
