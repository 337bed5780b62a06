"""Turn fish by 90 degrees from starts that differ by part of a node, with patches of three sizes.

python -m studies.turning_patch.turns > turns.csv
"""

import csv
import sys
from statistics import fmean
from typing import Any

import torch

from experiments.validation.levels import COMMANDED
from experiments.validation.refined_flows import swim

GIVEN: dict[str, Any] = {**COMMANDED, "levels": 2, "body_length": 64}
NUM_STARTS = 6
SIZES = (1.5, 2.0, 2.5)  # L


def main() -> None:
    """Write a row for each start: deviations from the uniform grid in the last beat, in percent."""
    generator = torch.Generator().manual_seed(5)
    others = (torch.rand(2, generator=generator).tolist() for _ in range(NUM_STARTS - 1))
    rows, uniform = [], []
    for start in ([0.0, 0.0], *others):
        places = [[x + dx / GIVEN["body_length"] for x, dx in zip(GIVEN["places"][0], start)]]
        grid, *patches = (
            swim(**GIVEN | {"places": places} | changes)
            for changes in ({"levels": 1}, *({"patch_bl": size} for size in SIZES))
        )
        uniform.append(grid["power"][-1])
        row = {"start, nodes aside": ", ".join(f"{x:.2f}" for x in start)}
        for quantity in ("power", "speed"):
            for size, patch in zip(SIZES, patches, strict=True):
                change = patch[quantity][-1] / grid[quantity][-1] - 1.0
                row[f"{quantity}, {size} L, %"] = f"{100.0 * change:+.2f}"
        for size, patch in zip(SIZES, patches, strict=True):
            row[f"density, {size} L, 1e-6"] = f"{1e6 * (patch['mass'] - grid['mass']):+.1f}"
        rows.append(row)
    for row, power in zip(rows, uniform, strict=True):
        row["power, uniform, %"] = f"{100.0 * (power / fmean(uniform) - 1.0):+.2f}"
    table = csv.DictWriter(sys.stdout, list(rows[0]), lineterminator="\n")
    table.writeheader()
    table.writerows(rows)


if __name__ == "__main__":
    torch.set_num_threads(1)
    main()
