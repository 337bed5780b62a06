"""Levels.

Each flow runs with levels, fine in a patch and coarser outside, and on the finest grid everywhere.
NACA0012 fish with Carling's gait and `BounceBack()` swim from rest in 10 L × 5 L, L = 100 with
three levels unless stated; of all beats after the first, in which they hardly move, the one that
deviates most counts. They swim freely along a closed tank for ten beats; for four (Re = 1000) at
angles to the grid, in frames that move with all edges, in nodes per step, and in a stream; they
turn by 90° (Re = 7142), commanded in the beats 3 and 4 of five, with L = 64 and two levels as well,
or by bending in the beats 3 to 10 of eleven; and two of L = 64 pass 0.6 L apart in one patch that
stays (Re = 1000, two levels, eight beats). A cylinder (D = 20) and half a one (D = 26, flat side
downstream) in a stream of 18 D × 9 D shed vortices that leave a patch of 5 D × 3 D. The force on a
free fish (Re = 7142, two levels, five beats) is averaged over four steps each. Uniform flow crosses
patches that walk at random (double precision).
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from matplotlib.figure import Figure

from experiments.validation.case import Case, Check, Job, Result, Runs, check_refined
from experiments.validation.refined_flows import cross_uniform_flow, feel_shifts, hold, swim

SPEED, POWER = {"speed": 0.003}, {"power": 0.007}
SWIM = SPEED | POWER
WAKE = {"drag": 0.002, "lift_amplitude": 0.01, "strouhal": 0.003}
MASS_LIMIT, NOISE_LIMIT, ROUND_OFF = 5e-6, 1.2, 1e-15
NAMES = {"drag": "C_d", "lift_amplitude": "C_l amplitude", "strouhal": "St"}
OWN = "own criterion"


@dataclass(frozen=True)
class Group:
    """Flows that are judged together.

    Args:
        name: what they are.
        limits: largest deviation from the finest grid everywhere, by quantity.
        flows: arguments of ``function`` by name, with more than one level.
        function: runs them.
        is_closed: whether no water enters or leaves.
        reason: why a limit is exceeded.
    """

    name: str
    limits: Mapping[str, float]
    flows: Mapping[str, Mapping[str, Any]]
    function: Any = swim
    is_closed: bool = False
    reason: str = ""

    def read(self, runs: Runs) -> dict[str, tuple[Result, Result]]:
        """Return the results of each flow with levels, and on the finest grid everywhere."""
        pairs = {name: (given, {**given, "levels": 1}) for name, given in self.flows.items()}
        return {name: (runs.get(**a), runs.get(**b)) for name, (a, b) in pairs.items()}


Given = Mapping[str, Any]
FINE: Given = {"levels": 3, "body_length": 100, "reynolds": 1000.0}
TWO: Given = {"levels": 2, "body_length": 64}
DISC: Given = {"levels": 2, "reynolds": 200.0, "diameter": 20}
MIDDLE = {"places": [[5.5, 2.6]], "edges": "moving"}
STREAM = {"places": [[5.0, 2.5]], "edges": "stream", "stream": 0.04}
ANGLES: Mapping[str, Given] = {
    name: {**MIDDLE, "headings": [180.0 + angle]}
    for name, angle in (("at rest", 0), ("30°", 30), ("45°", 45))
}
FRAMES: Mapping[str, Given] = {
    f"frame at {speed:+}": {"places": [[x, 2.6]], "edges": "moving", "stream": speed}
    for speed, x in ((0.08, 4.0), (-0.08, 8.2))
}
TURN = {**FINE, "reynolds": 7142.0, "places": [[7.5, 2.2]], "headings": [135.0]}
COMMANDED = {**TURN, "motion": "commanded", "turns": [0, 0, 45, 45, 0]}
FREE, TURNS = "free fish", "turns by 90°"
GROUPS = (
    Group(
        FREE,
        SWIM,
        {
            f"L = {grid['body_length']}, {grid['levels']} levels, Re = {re}": {
                **grid,
                "reynolds": float(re),
                "num_beats": 10,
            }
            for grid in (FINE, TWO)
            for re in (500, 7142)
        },
        is_closed=True,
    ),
    Group("angles", SWIM, {name: {**FINE, **own} for name, own in ANGLES.items()}),
    Group(
        "frames and stream",
        SWIM,
        {name: {**FINE, **own} for name, own in {**FRAMES, "stream of 0.04": STREAM}.items()},
    ),
    Group(
        TURNS,
        {**SWIM, "turned": 0.003},
        {
            "commanded": COMMANDED,
            "commanded, L = 64, 2 levels": {**COMMANDED, **TWO},
            "bending": {**TURN, "motion": "bending", "turns": [0, 0, *[15] * 8, 0]},
        },
        is_closed=True,
        reason="Uniform grids differ as much between starts, whatever the patch (study "
        "`turning_patch`).",
    ),
    Group(
        "passing fish",
        SWIM,
        {
            "L = 64, 2 levels": {
                **TWO,
                "places": [[6.1, 2.8], [3.9, 2.2]],
                "headings": [180.0, 0.0],
                "shared": [[2.9, 1.5], [7.1, 3.5]],
                "num_beats": 8,
            }
        },
        is_closed=True,
    ),
    Group(
        "wakes",
        WAKE,
        {
            "cylinder, Re = 100": {**DISC, "reynolds": 100.0},
            "cylinder, Re = 200": DISC,
            "half disc, Re = 200": {**DISC, "diameter": 26, "is_half": True},
        },
        hold,
    ),
)
SHIFTS = {"body_length": 100, "reynolds": 7142.0, "num_beats": 5}
FOUR: Given = {"levels": 4, "body_length": 200, "reynolds": 1000.0}
#: Finer grids without a uniform one: free fish, and what remains of two invariances.
FINEST = {
    f"L = 200, 4 levels, Re = {reynolds}": {**FOUR, "reynolds": float(reynolds), "num_beats": 10}
    for reynolds in (500, 7142)
}
INVARIANCES = {**ANGLES, **FRAMES}


def list_jobs() -> Iterator[Job]:
    """Return each flow with levels and without."""
    for group in GROUPS:
        for given in group.flows.values():
            for levels in (given["levels"], 1):
                yield Job(group.function, {**given, "levels": levels}, cost=1e9 / 4**levels)
    yield Job(feel_shifts, SHIFTS, cost=1e8)
    for given in (*({**FOUR, **own} for own in INVARIANCES.values()), *FINEST.values()):
        yield Job(swim, given, cost=1e10)
    yield Job(cross_uniform_flow, {"levels": 3}, cost=1e7)


def compare(refined: Result, uniform: Result, quantity: str, num_fish: int) -> tuple[float, float]:
    """Return the ratio farthest from 1 of all beats but the first, and that of their sums."""
    values, others = refined[quantity], uniform[quantity]
    if not isinstance(values, list):
        return values / others, values / others
    values, others = values[num_fish:], others[num_fish:]
    ratios = (a / b for a, b in zip(values, others, strict=True))
    return max(ratios, key=lambda ratio: abs(ratio - 1.0)), sum(values) / sum(others)


def judge(runs: Runs) -> Iterator[Check]:
    """Compare with the finest grid everywhere."""
    for group in GROUPS:
        pairs = group.read(runs)
        for quantity, limit in group.limits.items():
            found = {
                name: compare(*pair, quantity, len(group.flows[name].get("headings", [0])))
                for name, pair in pairs.items()
            }
            largest = {name: ratio for name, (ratio, _) in found.items()}
            worst = max(largest, key=lambda name: abs(largest[name] - 1.0))
            mean = 100.0 * (found[worst][1] - 1.0)
            words = [group.reason] if abs(largest[worst] - 1.0) > limit else []
            if group.function is swim and quantity != "turned":
                words.append(f"All beats after the first together deviate by {mean:+.2f} %.")
            name, note = f"{group.name}: {NAMES.get(quantity, quantity)} / uniform", " ".join(words)
            yield check_refined("", name, largest, 1.0, OWN, limit, at=worst, note=note)
        if group.is_closed:
            yield _judge_mass(group.name, pairs)
        if group.name == FREE:
            yield _record_speeds(runs, pairs)
    yield from _judge_rest(runs)


def _judge_mass(group: str, pairs: Mapping[str, tuple[Result, Result]]) -> Check:
    """Check the water that is lost or gained more than on the finest grid everywhere."""
    changes = {name: one["mass"] - other["mass"] for name, (one, other) in pairs.items()}
    worst = max(changes, key=lambda name: abs(changes[name]))
    updates = (f"{b['updates'] / a['updates']:.1f}" for a, b in pairs.values())
    note = (
        "At the edges of a patch mass is conserved to the error of interpolation, which vortices "
        f"that leave raise. Levels update fewer nodes: {', '.join(dict.fromkeys(updates))} times."
    )
    options: Any = {"at": worst, "is_absolute": True, "note": note}
    quantity = f"{group}: density gained less uniform"
    return check_refined("", quantity, changes, 0.0, OWN, MASS_LIMIT, **options)


def _record_speeds(runs: Runs, pairs: Mapping[str, tuple[Result, Result]]) -> Check:
    """Record the last speed of free fish on every grid."""
    speeds: dict[str, float] = {}
    for name, (one, other) in pairs.items():
        length, _, reynolds = name.split(", ")
        speeds |= {name: one["speed"][-1], f"{length}, uniform, {reynolds}": other["speed"][-1]}
    for name, given in FINEST.items():
        speeds[name] = runs.get(**given)["speed"][-1]
    return check_refined("", f"{FREE}: speed in beat 10, L / T", speeds, at=[*speeds][-1])


def _judge_rest(runs: Runs) -> Iterator[Check]:
    """Check the force around shifts and uniform flow, and record two invariances."""
    felt, error = runs.get(**SHIFTS), runs.get(levels=3)["error"]
    name, note = "force on a fish: rms third difference near shifts", f"{felt['shifts']} shifts."
    yield Check(f"{name} / elsewhere", felt["ratio"], (0.0, NOISE_LIMIT), OWN, note=note)
    name = "uniform flow: largest error of a population, 3 levels"
    yield Check(name, error, 0.0, "exact", ROUND_OFF, is_absolute=True)
    grids = {
        "L = 100, uniform": {**FINE, "levels": 1},
        "L = 100, 3 levels": FINE,
        "L = 200, 4 levels": FOUR,
    }
    rest, *others = (
        {grid: sum(runs.get(**{**given, **own})["speed"][2:]) for grid, given in grids.items()}
        for own in INVARIANCES.values()
    )
    for name, speeds in zip([*INVARIANCES][1:], others, strict=True):
        changes = {grid: speed / rest[grid] - 1.0 for grid, speed in speeds.items()}
        quantity = f"fish, {name}: change of the speed over beats 3 and 4"
        yield check_refined("", quantity, changes, at=[*grids][-1])


def draw(figure: Figure, runs: Runs) -> None:
    """Draw speed and power of each beat, relative to the finest grid everywhere."""
    every = figure.subplots(1, 2)
    groups = [group for group in GROUPS if group.name in (FREE, TURNS)]
    chosen = {name: pair for group in groups for name, pair in group.read(runs).items()}
    for axes, name in zip(every, ("speed", "power"), strict=True):
        for label, (refined, uniform) in chosen.items():
            pairs = zip(refined[name], uniform[name], strict=True)
            values = [100.0 * (a / b - 1.0) for a, b in pairs][1:]
            axes.plot(range(2, len(values) + 2), values, "o-", markersize=3, label=label)
        axes.axhline(0.0, color="0.7", linewidth=0.8, zorder=0)
        axes.set(xlabel="beat", ylabel=f"{name} against uniform, %")
    figure.legend(*every[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)


CASE = Case(
    "levels", __doc__, "the finest grid everywhere", list(list_jobs()), judge, draw, size=(8.0, 3.6)
)
