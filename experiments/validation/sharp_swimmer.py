"""Swimmer with bounce-back.

A NACA0012 fish with Carling's gait starts from rest in a closed tank of 10 L × 5 L and swims
freely, as in *Self-propelled anguilliform swimmer*, but with `BounceBack()`, on coarse and fine
grids at two Reynolds numbers. The criteria ask how little a coarse grid changes: the speed over the
tenth beat and the mean power of the muscles in it are compared with the values at L = 100, and L =
100 with L = 140.
"""

from collections.abc import Iterator

from matplotlib.figure import Figure

from experiments.validation.case import Case, Check, Job, Runs
from experiments.validation.swimmer import NUM_BEATS, make_swim

REYNOLDS = (500.0, 7142.0)
LENGTHS = (32, 50, 70, 100, 140)
COARSE = ("immersed-boundary", (32, 50, 100))
NAMES = {"immersed-boundary": "immersed boundary", "bounce-back": "bounce-back"}
# at most this far from the speed at L = 100, and of the power at L = 50
LIMITS = {32: 0.20, 50: 0.08}
POWER_LIMIT = 0.10
FINE_LIMIT = 0.08
OWN = "own criterion"
REASONS = {
    500.0: "",
    7142.0: "The boundary layer, about L / 60 thick, is half a node at L = 32 and one at L = 50. ",
}


def list_jobs() -> Iterator[Job]:
    """Return the sharp swimmers, and the others for comparison."""
    for reynolds in REYNOLDS:
        for skin, lengths in (("bounce-back", LENGTHS), COARSE):
            for n in lengths:
                yield make_swim(n, NUM_BEATS, reynolds=reynolds, skin=skin)


def judge(runs: Runs) -> Iterator[Check]:
    """Compare coarse grids with fine ones."""
    for reynolds in REYNOLDS:
        given = {"num_beats": NUM_BEATS, "reynolds": reynolds}
        sharp = runs.by("body_length", skin="bounce-back", **given)
        soft = runs.by("body_length", skin="immersed-boundary", **given)
        speed = {n: run["speed"][-1] for n, run in sharp.items()}
        power = {n: run["power"][-1] for n, run in sharp.items()}
        at = f"Re = {reynolds:g}"
        for n, limit in LIMITS.items():
            other = soft[n]["speed"][-1] / soft[100]["speed"][-1]
            yield Check(
                f"speed at L = {n} / at L = 100, {at}",
                speed[n] / speed[100],
                1.0,
                OWN,
                limit,
                resolution=f"L = {n}",
                refinement={f"L = {m}": value for m, value in speed.items()},
                note=f"{REASONS[reynolds]}With the immersed boundary {other:.3f}. The refinement "
                "lists speeds, L / T.",
            )
        yield Check(
            f"speed at L = 100 / at L = 140, {at}",
            speed[100] / speed[140],
            1.0,
            OWN,
            FINE_LIMIT,
            resolution="L = 100",
        )
        yield Check(
            f"power of the muscles at L = 50 / at L = 100, {at}",
            power[50] / power[100],
            1.0,
            OWN,
            POWER_LIMIT,
            resolution="L = 50",
            refinement={f"L = {m}": value for m, value in power.items()},
            note=f"{REASONS[reynolds]}With the immersed boundary "
            f"{soft[50]['power'][-1] / soft[100]['power'][-1]:.3f}. The refinement lists powers, "
            "ρ L⁴ / T³.",
        )


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


CASE = Case(
    "sharp-swimmer",
    __doc__,
    "the same swimmer on finer grids",
    list(list_jobs()),
    judge,
    draw,
    size=(8.0, 3.6),
)
