"""Predation by two fish that pursue the same food."""

from typing import Annotated, ClassVar

import torch
from pydantic import Field, NonNegativeFloat, PositiveFloat
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from fishrl.envs.sense import Sense
from fishrl.envs.sensors import MIRRORED_TARGET, TARGET, compute_gap, sense_target
from fishrl.envs.starts import place_outline
from fishrl.envs.tasks.predation import AbstractPredation
from fishrl.physics.fast.solver import InPlaceSolver
from fishrl.physics.levels.patch import Patch
from fishrl.physics.placement import MIN_GAP


class PredationPair(AbstractPredation):
    """Catch the same food as another fish, and keep clear of that fish.

    Food, walls and the actions of each fish are as in ``Predation``. An episode ends for both fish
    when one of them catches the food or comes too near a wall, and on contact: when markers of the
    two are nearer than ``contact_bl``, so that they never overlap.

    Fish 0 starts in the lower half of the range of starts, fish 1 in the upper half. The range is
    narrower along y than in ``Predation``, where a fish may start next to a wall and hit it
    before it can turn: here that would end the episode of both.

    Args:
        contact_bl: distance of the outlines that counts as contact, in body lengths.
        contact_penalty: penalty of contact for each fish.
        start_gap_bl: smallest distance of the two noses along y at the start.
    """

    num_fish: ClassVar[int] = 2

    start_y_bl: tuple[float, float] = (1.0, 4.0)
    contact_bl: Annotated[float, Field(gt=0, le=10)] = 0.15
    contact_penalty: NonNegativeFloat = 20.0
    start_gap_bl: PositiveFloat = 0.75

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.contact_bl * self.body_length < MIN_GAP:
            raise ValueError(
                f"contact_bl = {self.contact_bl}: is {self.contact_bl * self.body_length:g} nodes; "
                f"must be at least {MIN_GAP:g} node"
            )
        nearest = torch.zeros(1, self.num_draws, dtype=torch.float64)
        nearest[0, 1] = 1.0 - 2.0**-53
        self.check_starts(self.starts_from(nearest))

    def list_patches(self) -> tuple[Patch, ...]:
        """Return one patch that holds the fish anywhere in the tank."""
        return (Patch.between((0.0, 0.0), self.domain),)

    def check_starts(self, starts: TensorDictBase) -> None:
        """Also check that the fish do not touch."""
        super().check_starts(starts)
        outlines = place_outline(starts, self.fish)
        gap = compute_gap(outlines[:, 0], outlines[:, 1]) / self.body_length
        if not (gap >= self.contact_bl).all():
            raise ValueError(
                f"starts have fish {float(gap.min()):.3g} L apart: must be at least contact_bl = "
                f"{self.contact_bl}"
            )

    @property
    def senses(self) -> tuple[Sense, ...]:
        """The nose of the other fish, and the senses of ``Predation``."""
        other = Sense("place of the other fish", TARGET, lambda now: now["other"], MIRRORED_TARGET)
        return other, *super().senses

    @property
    def lanes(self) -> tuple[tuple[int, int], tuple[int, int]]:
        """First and last node of the noses along y, of fish 0 and of fish 1."""
        low, high = self.start_range[1]
        room = (high - low - round(self.start_gap_bl * self.body_length)) // 2
        if room < 0:
            raise ValueError(
                f"start_gap_bl = {self.start_gap_bl}: two noses do not fit into start_y_bl = "
                f"{self.start_y_bl} clear of the walls; lower it, or enlarge domain_bl"
            )
        return (low, low + room), (high - room, high)

    def measure(self, solver: InPlaceSolver, starts: TensorDictBase) -> TensorDict:
        """Also measure the gap of the two fish, and where each has the other."""
        outlines, now = [solver.markers(fish) for fish in (0, 1)], super().measure(solver, starts)
        noses, headings = [outline[:, 0] for outline in outlines], now["heading"].unbind(1)
        other = [
            sense_target(noses[fish], headings[fish], noses[1 - fish], body_length=self.body_length)
            for fish in (0, 1)
        ]
        return now.set("other", torch.stack(other, 1)).set("gap", compute_gap(*outlines))

    def reward(self, before: TensorDictBase, now: TensorDictBase) -> dict[str, Tensor]:
        """Add the penalty for contact, which both fish pay.

        Terms:
            contact: −``contact_penalty`` if the gap is less than ``contact_bl``, 0 otherwise.
        """
        penalty = -self.contact_penalty * self._has_contact(now)[:, None].expand(-1, self.num_fish)
        return super().reward(before, now) | {"contact": penalty}

    def is_terminated(self, now: TensorDictBase) -> Tensor:
        """Return whether the food is caught, a wall is hit, or the fish touch."""
        return super().is_terminated(now) | self._has_contact(now)

    def count_safe_steps(self, now: TensorDictBase) -> Tensor:
        """Return the fewest steps in which a wall, the food or the other fish can be reached."""
        gap = now["gap"] - self.contact_bl * self.body_length
        return torch.minimum(super().count_safe_steps(now), gap / (2.0 * self.marker_speed))

    def report(self, now: TensorDictBase) -> dict[str, Tensor]:
        """Return ``captured`` and ``contact`` ``[B]``, and ``caught`` ``[B, 2]``, by which fish."""
        caught = self.has_caught(now)
        return {"captured": caught.any(1), "caught": caught, "contact": self._has_contact(now)}

    def _has_contact(self, now: TensorDictBase) -> Tensor:
        gap: Tensor = now["gap"]
        return gap < self.contact_bl * self.body_length
