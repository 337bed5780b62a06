"""Where levels are fine behind a half disc: a patch for disc and fish each, or one for both."""

from dataclasses import replace
from typing import NamedTuple

from fishrl.envs.stations import SafeArea
from fishrl.envs.streams import AbstractStreamTask
from fishrl.physics.levels.patch import (
    CLEARANCE,
    MARGIN_BL,
    MARGIN_NODES,
    RING,
    Patch,
    inset,
    measure_patch,
)


class WakePatches(NamedTuple):
    """Patches, and what the fish must keep from the disc for them to stay apart."""

    patches: tuple[Patch, ...]
    least_x: float | None  #: of a marker of the fish, nodes; None unless it has its own patch


def place_patches(task: AbstractStreamTask, area: SafeArea) -> WakePatches:
    """Return patches of the largest disc and of a fish that ends with its nose outside ``area``.

    Each has its own with two levels if half the margin is left between disc and fish. The fish's
    follows it and does not pass the end of the disc's. Otherwise they share one that stays.
    """
    length, unit, (x, _) = task.body_length, 2 ** (task.levels - 1), task.origin
    if not task.discs or task.levels == 1:
        return WakePatches((), None)
    disc = 0.5 * max(task.stream.diameters_bl)
    margin = max(MARGIN_BL * length, 2.0 * MARGIN_NODES)
    # that markers keep from the end of their patch, as they move between two checks
    reach = task.travel + inset(0, task.levels) + RING + task.skin.margin + 1.0
    begin = unit * ((x + length * area.near_bl - reach) // unit)
    end = begin - unit  # of the disc's, which its nodes may exceed by one
    if task.levels == 2 and end - x >= 0.5 * margin and _fits(task, begin):
        around = disc + margin / length
        box = task.frame("patch", x_bl=(-around, (end - x) / length), aside_bl=around)
        width, height = task.domain
        fish = Patch(within=((begin, 0.0), (width - 1.0, height - 1.0)))
        around_disc = replace(Patch.between(box.low, box.high), bodies=(1,))
        return WakePatches((fish, around_disc), begin + reach)
    reach = 1.05 + reach / length
    ahead = min(area.near_bl - reach, -disc - 0.25)
    aside = max(area.aside_bl + reach, disc + 0.25)
    box = task.frame("patch", x_bl=(ahead, area.far_bl + reach), aside_bl=aside)
    return WakePatches((Patch.between(box.low, box.high),), None)


def _fits(task: AbstractStreamTask, begin: float) -> bool:
    """Return whether the domain has room for the patch of a fish from x = ``begin`` nodes on."""
    unit, (width, height) = 2 ** (task.levels - 1), task.domain
    every = ((0, 0), (width // unit, height // unit))
    side = unit * (measure_patch(Patch(), task.bodies, task.levels, every)[0][0] // 2)
    return bool(side <= min(height, width - begin) - 2 * unit * CLEARANCE - 1)
