"""Swimmer with bounce-back.

A NACA0012 fish with Carling's gait starts from rest in a closed tank of 10 L × 5 L and swims
freely, as in *Self-propelled anguilliform swimmer*, but with `BounceBack()`, on coarse and fine
grids at two Reynolds numbers. The criteria ask how little a coarse grid changes: the speed over the
tenth beat and the mean power of the muscles in it are compared with the values at L = 100, and L =
100 with L = 140.
"""

from collections.abc import Iterator
from typing import Any

from matplotlib.figure import Figure

from experiments.validation.case import Case, Check, Runs
from experiments.validation.swimmer import NUM_BEATS, make_swim

REYNOLDS = (500.0, 7142.0)
LENGTHS = (32, 50, 70, 100, 140)
COARSE = ("immersed-boundary", (32, 50, 100))
NAMES = {"immersed-boundary": "immersed boundary", "bounce-back": "bounce-back"}
# quantity, its name, what the refinement lists; two grids, and how far they may differ
SPEEDS, POWERS = "speeds, L / T", "powers, ρ L⁴ / T³"
COMPARED = (
    ("speed", "speed", SPEEDS, 32, 100, 0.20),
    ("speed", "speed", SPEEDS, 50, 100, 0.08),
    ("speed", "speed", "", 100, 140, 0.08),
    ("power", "power of the muscles", POWERS, 50, 100, 0.10),
)
REASONS = {
    500.0: "",
    7142.0: "The boundary layer, about L / 60 thick, is half a node at L = 32 and one at L = 50. ",
}


JOBS = [
    make_swim(n, NUM_BEATS, reynolds=reynolds, skin=skin)
    for reynolds in REYNOLDS
    for skin, lengths in (("bounce-back", LENGTHS), COARSE)
    for n in lengths
]


def judge(runs: Runs) -> Iterator[Check]:
    """Compare coarse grids with fine ones."""
    for reynolds in REYNOLDS:
        given = {"num_beats": NUM_BEATS, "reynolds": reynolds}
        sharp, soft = (runs.by("body_length", skin=s, **given) for s in reversed(NAMES))
        for key, name, listed, n, finer, limit in COMPARED:
            ours, others = ({m: run[key][-1] for m, run in each.items()} for each in (sharp, soft))
            options: dict[str, Any] = {"resolution": f"L = {n}"}
            if listed:
                other = f"With the immersed boundary {others[n] / others[finer]:.3f}."
                options["refinement"] = {f"L = {m}": value for m, value in ours.items()}
                options["note"] = f"{REASONS[reynolds]}{other} The refinement lists {listed}."
            quantity = f"{name} at L = {n} / at L = {finer}, Re = {reynolds:g}"
            criterion = (1.0, "own criterion", limit)
            yield Check(quantity, ours[n] / ours[finer], *criterion, **options)


def draw(figure: Figure, runs: Runs) -> None:
    """Draw the final speed against the grid."""
    every = figure.subplots(1, len(REYNOLDS), sharey=True)
    for axes, reynolds in zip(every, REYNOLDS, strict=True):
        for skin, name in NAMES.items():
            found = runs.by("body_length", num_beats=NUM_BEATS, reynolds=reynolds, skin=skin)
            speeds = [run["speed"][-1] for run in found.values()]
            axes.plot([1.0 / n for n in found], speeds, "o-", label=name)
        axes.set(xlabel="1 / L", title=f"Re = {reynolds:g}", xlim=(0.0, None))
    every[0].set_ylim(0.0, None)
    every[0].set_ylabel(f"speed over beat {NUM_BEATS}  U T / L")
    every[0].legend()


SOURCE = "the same swimmer on finer grids"
CASE = Case("sharp-swimmer", __doc__, SOURCE, JOBS, judge, draw, size=(8.0, 3.6))
