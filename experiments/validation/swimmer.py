"""Self-propelled anguilliform swimmer.

A NACA0012 fish with Carling's gait (a(x) = 0.125 (x + 0.03125) / 1.03125, wavelength L) starts from
rest, amplitude rising over the first beat, in a closed tank of 10 L × 5 L at L² / (T ν) = 7142, the
tail's speed at 0.07 nodes per step (Mach 0.12). The flow moves and turns it; body and water have
equal density, so the skin is free of net force and torque in every step. Speed is the displacement
of the centre of mass along the tank over each beat, power what the muscles give, Σ F · u_def, mean
over the beat.
"""

from collections.abc import Sequence

from matplotlib.figure import Figure

from experiments.figures import COLOURS
from experiments.validation.case import Case, Check, Job, Results, check_finest, select
from experiments.validation.swimming import make_swim

LENGTHS = (50, 70, 100, 140, 200)
QUICK_LENGTHS = (50,)
NUM_BEATS = 10
VARIANT_LENGTH = 100
VARIANTS: dict[str, dict[str, float | str | bool]] = {
    "tank twice as high": {"height_bl": 10.0},
    "markers 0.45 nodes inside": {"inset": 0.45},
    "heading held": {"is_free": False},
    "midline keeps its length": {"keeps_length": True},
    "eel, 8 % thick": {"section": "eel", "thickness": 0.08},
    "eel, midline keeps its length": {"section": "eel", "thickness": 0.08, "keeps_length": True},
}
# Of all refinement steps the last must change the final speed by no more than this.
GRID_CHANGE = 0.05
WAVE_SPEED = 1.0  # of Carling's gait, wavelength L, in L / T
CARLING = "Carling, Williams & Bowtell 1998, J. Exp. Biol. 201, 3143: 0.77 of the wave speed, 2D"
NO_SOURCE = (
    "No other published two-dimensional speed of this swimmer could be found in text: Gazzola et "
    "al. 2011 and Zhu et al. 2021, whom the paper compares with, give curves only, IBAMR's eel2d "
    "(the same case) states no speed, and Kern & Koumoutsakos 2006 is three-dimensional. So the "
    "speed is judged by its convergence and stands beside Carling's, whose creature is thinner and "
    "whose envelope is another."
)


def _label(body_length: int, variant: str = "") -> str:
    return f"L = {body_length}" + (f", {variant}" if variant else "")


def make_jobs(quick: bool) -> list[Job]:
    """Return a swim at each resolution, and the variants at one."""
    if quick:
        return [make_swim(_label(length), length, NUM_BEATS) for length in QUICK_LENGTHS]
    jobs = [make_swim(_label(length), length, NUM_BEATS) for length in LENGTHS]
    return jobs + [
        make_swim(_label(VARIANT_LENGTH, name), VARIANT_LENGTH, NUM_BEATS, **changes)
        for name, changes in VARIANTS.items()
    ]


def judge(results: Results) -> Sequence[Check]:
    """Judge the convergence of the speed and set the rest beside what there is."""
    runs = select(results, {n: _label(n) for n in LENGTHS})
    final = {n: run["speed"][-1] for n, run in runs.items()}
    checks = [
        check_finest(
            f"speed in beat {NUM_BEATS}, L / T", final, 0.77 * WAVE_SPEED, CARLING,
            symbol="L", note=NO_SOURCE,
        ),
        check_finest(
            "power of the muscles, ρ L⁴ / T³",
            {n: run["power"][-1] for n, run in runs.items()},
            symbol="L",
        ),
        check_finest(
            "slip at the skin / tail speed",
            {n: run["slip"] / run["tail_speed"] for n, run in runs.items()},
            symbol="L",
        ),
    ]  # fmt: skip
    if len(runs) < len(LENGTHS):
        return checks
    coarse, middle, fine = (final[n] for n in LENGTHS[::2])
    ratio = (middle - coarse) / (fine - middle)
    checks.append(
        Check(
            quantity="change of the speed from L = 140 to 200",
            ours=abs(final[200] / final[140] - 1.0),
            reference=(0.0, GRID_CHANGE),
            source="own criterion",
            resolution="L = 140–200",
            note=(
                f"Doubling L from 50 and from 100 changes the speed by {middle - coarse:.3f} "
                f"and {fine - middle:.3f} L / T, a ratio of {ratio:.2f}; carried on, it would "
                f"end at {fine + (fine - middle) / (ratio - 1.0):.3f} L / T. A coarse fish "
                "swims more slowly: its boundary layer is a few nodes thick."
            ),
        )
    )
    return checks + [
        Check(
            quantity=f"speed in beat {NUM_BEATS}, {name}",
            ours=results[_label(VARIANT_LENGTH, name)]["speed"][-1],
            resolution=_label(VARIANT_LENGTH),
            note=f"{final[VARIANT_LENGTH]:.3f} L / T without this change.",
        )
        for name in VARIANTS
    ]


def draw(results: Results) -> Figure:
    """Draw speed against time."""
    figure = Figure(figsize=(9.0, 4.0), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    variants = [_label(VARIANT_LENGTH, variant) for variant in ("", *VARIANTS)]
    for axes, wanted, title in (
        (left, [_label(n) for n in LENGTHS], "resolution"),
        (right, variants, f"variants, L = {VARIANT_LENGTH}"),
    ):
        shown = [name for name in wanted if name in results]
        for name, colour in zip(shown, COLOURS, strict=False):
            speeds = results[name]["speed"]
            middles = [beat + 0.5 for beat in range(len(speeds))]
            axes.plot(middles, speeds, color=colour, marker="o", ms=3, label=name)
        axes.set(xlabel="time  t / T", title=title, ylim=(0.0, None))
        if shown:
            axes.legend(fontsize=8)
    left.set_ylabel("speed over each beat  U T / L")
    return figure


CASE = Case("swimmer", __doc__, CARLING, make_jobs, judge, draw)
