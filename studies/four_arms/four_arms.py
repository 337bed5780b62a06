"""Table and picture of the four arms, from the curves of their trainings.

``data/curves.json`` holds of each training, by arm and seed, a value every 2,560 decisions: the
mean duration in T and the share of 20 T of the training episodes that ended since the last one;
and the decisions at its end.
"""

import csv
import json
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

FOLDER = Path(__file__).parent
SIGHT = "place, drift, heading"
ARMS = {  # observed besides own motion
    "sight": SIGHT,
    "all": f"{SIGHT}, lateral line",
    "line": "lateral line",
    "own": "–",
    "line16": "lateral line, 16 observations",
    "own16": "–, 16 observations",
}
COLOURS = {"sight": "#00aa55", "all": "#0066cc", "line": "#dd6600", "own": "#888888"}
LABELS = {"sight": SIGHT, "all": "the same and lateral line", "line": "lateral line"}


def write_table(curves: dict) -> None:
    """Write the means between 50 and 60 and between 64 and 74 thousand decisions."""
    with (FOLDER / "data/arms.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file, lineterminator="\n")
        means = ("50 to 60 thousand, T", "64 to 74 thousand, T", "of these last 20 T, %")
        table.writerow(["observed besides own motion", "seed", *means, "decisions"])
        for arm, what in ARMS.items():
            for seed in range(5):
                if (curve := curves.get(f"{arm}-{seed}")) is None:
                    continue
                count = np.array(curve["decisions"])
                early, late = (count >= 50_000) & (count <= 60_000), (count >= 64_000) & (count <= 74_300)
                numbers = [f"{np.array(curve['duration_T'])[early].mean():.1f}", "", ""]
                if late.any():
                    numbers[1] = f"{np.array(curve['duration_T'])[late].mean():.1f}"
                    numbers[2] = f"{100 * np.array(curve['survived'])[late].mean():.0f}"
                table.writerow([what, seed, *numbers, curve["end"]])


def draw(curves: dict) -> None:
    """Draw mean and range over seeds; each point is the mean of three neighbours."""
    figure, axes = plt.subplots(figsize=(7, 3.8), layout="constrained")
    x = np.arange(2560, 74_000, 2560)
    for arm, colour in COLOURS.items():
        seeds = [curves[f"{arm}-{seed}"] for seed in range(5)]
        smooth = (np.convolve(np.pad(c["duration_T"], 1, mode="edge"), np.ones(3) / 3, "valid") for c in seeds)
        each = np.array([np.interp(x, c["decisions"], y) for c, y in zip(seeds, smooth, strict=True)])
        axes.fill_between(x / 1e3, each.min(0), each.max(0), color=colour, alpha=0.2, lw=0)
        label = LABELS.get(arm, "own motion alone")
        axes.plot(x / 1e3, each.mean(0), color=colour, lw=2, label=label)
    axes.set(xlim=(0, 74), ylim=(0, 20), xlabel="decisions, thousands")
    axes.set_ylabel("mean duration of training episodes, T")
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(loc="upper left", frameon=False)
    figure.savefig(FOLDER / "curves.png", dpi=110)


if __name__ == "__main__":
    records = json.loads((FOLDER / "data/curves.json").read_text(encoding="utf-8"))
    write_table(records)
    draw(records)
