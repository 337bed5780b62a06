"""How wrong a free swimmer's speed is on each grid, from the stored results of validation."""

import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path

FOLDER = Path("docs/validation")
#: Grids of one skin and Reynolds number, of nearly constant ratio, that show their order.
LAST = (70, 100, 140)
Grid = tuple[int, int]  # L, levels


def read_errors(folder: Path = FOLDER) -> dict[Grid, dict[int, float]]:
    """Return the deviation of the speed in beat 10 from its limit, by grid and Reynolds number.

    The limit, on an infinitely fine grid, has the order that the speeds of ``LAST`` show.
    """
    speeds: dict[int, dict[Grid, float]] = {}
    for grid, reynolds, speed in _read_speeds(folder):
        speeds.setdefault(reynolds, {})[grid] = speed
    errors: dict[Grid, dict[int, float]] = {}
    for reynolds, found in speeds.items():
        limit = extrapolate(*(found[length, 1] for length in LAST))
        for grid, speed in found.items():
            errors.setdefault(grid, {})[reynolds] = speed / limit - 1.0
    return errors


def extrapolate(coarse: float, middle: float, fine: float) -> float:
    """Return the limit of three values of which each halves, or so, its distance from it."""
    ratio = (fine - middle) / (middle - coarse)
    return fine + (fine - middle) * ratio / (1.0 - ratio)


def _read_speeds(folder: Path) -> Iterator[tuple[Grid, int, float]]:
    """Yield grid, Reynolds number and speed (L / T) of each swimmer with bounce-back."""
    for file, quantity in (("sharp-swimmer", "speed at L = 32"), ("levels", "free fish: speed in")):
        for check in json.loads((folder / f"{file}.json").read_text(encoding="utf-8"))["checks"]:
            if check["quantity"].startswith(quantity):
                yield from _read_names(check["refinement"], check["quantity"])


def _read_names(speeds: Mapping[str, float], quantity: str) -> Iterator[tuple[Grid, int, float]]:
    for name, speed in speeds.items():
        length, reynolds = (
            int(re.findall(rf"{symbol} = (\d+)", f"{name} {quantity}")[index])
            for symbol, index in (("L", 0), ("Re", -1 if "Re" in quantity else 0))
        )
        levels = re.search(r"(\d) levels", name)
        yield (length, int(levels[1]) if levels else 1), reynolds, speed
