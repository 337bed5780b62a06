"""Where the method holds.

Fish (Re = 7000, commanded heading) turn by −15°, 0 or 15° at random in each beat, for up to 14
beats or until 0.3 L from a wall. A flow has diverged if it is not finite or faster than 0.5 nodes
per step. The map of collision rates is measured at the speed of the paper's scale, T = 600 at L =
100, where the tail moves at 0.131 nodes per step. In addition, a cylinder in an impulsively started
stream (12 D × 8 D, with fixed velocity or density at the edges, which reflects the sound of the
start) is run for 6 D of travel. A case is refused if τ is too close to one half.
"""

from collections.abc import Iterator, Mapping
from itertools import product
from math import pi, radians
from typing import Any

import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.validation.case import Case, Check, Job, Result, Runs, check_refined
from experiments.validation.plots import name_ticks
from experiments.validation.wake import PINNED, STREAM, start_stream
from fishrl.physics import Cylinder, Fixed, ImmersedBoundary, InPlaceSolver, Scales
from fishrl.physics.cases import make_swimmer_config
from fishrl.physics.collision import Rates

REYNOLDS = 7000.0
NUM_BEATS = 14
WALL_MARGIN_BL = 0.3  # an episode ends here, so that no fish is pressed into a wall
DEFAULT = Rates()
ENERGIES = (1.0, 1.4, 1.64)
FLUXES = (1.0, 1.2, 1.5, 1.7, 1.9)
NUM_EPISODES = 8
PAPER_SPEED = 0.785 / 6.0  # of the tail at the paper's L = 100, T = 600
SHIPPED = ("small, L = 50", "paper, L = 100")  # presets of predation
# name: L, budget, episodes
PRESETS = {
    "small, L = 50": (50, 0.07, 64),
    "L = 100, speed of small": (100, 0.07, 8),
    "L = 50, speed of paper": (50, PAPER_SPEED, 64),
    "paper, L = 100": (100, PAPER_SPEED, 8),
}
DIAMETERS, SPEEDS = (10, 20, 40), (0.05, 0.1, 0.15, 0.2)
CYLINDER_REYNOLDS = (100, 400, 1600, 6400)
TRAVELS = 6.0  # diameters
RAN, DIVERGED, REFUSED = "runs", "diverges", "refused"
MARKS = {RAN: ("#009E73", "o"), DIVERGED: ("#D55E00", "X"), REFUSED: ("#999999", "_")}


def turn_at_random(
    *, body_length: int, max_wall_speed: float, energy: float, flux: float, num_episodes: int
) -> Result:
    """Let fish turn at random; return the number that diverged, and the largest speed seen."""
    scales = Scales.from_budget(
        body_length=body_length, reynolds=REYNOLDS, max_wall_speed=max_wall_speed
    )
    config = make_swimmer_config(
        scales, rates=Rates(energy=energy, flux=flux), skin=ImmersedBoundary()
    )
    solver = InPlaceSolver(config=config, frequency=1.0 / scales.period, num_workers=0)
    generator = torch.Generator().manual_seed(0)
    size = torch.tensor([config.width, config.height])
    num_diverged, fastest = 0, 0.0
    for _ in range(num_episodes):
        heading = 2.0 * pi * torch.rand(1, generator=generator)
        solver.reset_(torch.ones(1, dtype=torch.bool), heading=heading)
        for fifth in range(5 * NUM_BEATS):
            if fifth % 5 == 0:
                turn = (torch.randint(3, (1,), generator=generator) - 1) * radians(15.0)
                solver.command_(turn, scales.period)
            solver.advance_(2 * (scales.period // 10))
            if solver.is_diverged().any():
                num_diverged += 1
                break
            fastest = max(fastest, float(solver.macroscopic()[1].norm(dim=1).max()))
            markers, margin = solver.markers(), WALL_MARGIN_BL * body_length
            if not ((markers > margin) & (markers < size - margin)).all():
                break
    return {"diverged": num_diverged, "fastest": fastest}


def start_cylinder(*, diameter: int, speed: float, reynolds: float) -> Result:
    """Start a stream at once past a cylinder; return its fate, ``RAN, DIVERGED`` or ``REFUSED``."""
    try:
        solver = start_stream(
            Cylinder(diameter=diameter, motion=Fixed()),
            (4.0 * diameter, 4.0 * diameter),
            size=(12 * diameter, 8 * diameter),
            tau=3.0 * speed * diameter / reynolds + 0.5,
            speed=speed,
            outflow=PINNED,
            sides=STREAM,
        )
    except ValueError:
        return {"fate": REFUSED}
    solver.advance_(2 * round(0.5 * TRAVELS * diameter / speed))
    return {"fate": DIVERGED if solver.is_diverged().any() else RAN}


FISH = [(50, PAPER_SPEED, e, f, NUM_EPISODES) for e, f in product(ENERGIES, FLUXES)]
FISH += [(n, u, DEFAULT.energy, DEFAULT.flux, num) for n, u, num in PRESETS.values()]
JOBS = [
    Job(
        turn_at_random,
        {"body_length": n, "max_wall_speed": u, "energy": e, "flux": f, "num_episodes": num},
        cost=50.0 * n**3 * 0.785 / u * NUM_BEATS * num,
    )
    for n, u, e, f, num in FISH
] + [
    Job(start_cylinder, {"diameter": d, "speed": u, "reynolds": re}, cost=96 * d**3 * TRAVELS / u)
    for d, u, re in product(DIAMETERS, SPEEDS, CYLINDER_REYNOLDS)
]


def _read_shares(runs: Runs) -> dict[tuple[float, float], float]:
    """Return the share of diverged episodes at the paper's speed by energy and flux."""
    fixed: Any = {"body_length": 50, "max_wall_speed": PAPER_SPEED, "num_episodes": NUM_EPISODES}
    return {
        (e, f): run["diverged"] / NUM_EPISODES
        for e in ENERGIES
        for f, run in runs.by("flux", energy=e, **fixed).items()
    }


def judge(runs: Runs) -> Iterator[Check]:
    """Check the presets; record the maps."""
    for name, (length, speed, num) in PRESETS.items():
        rates: Any = {"energy": DEFAULT.energy, "flux": DEFAULT.flux, "num_episodes": num}
        run = runs.by("body_length", max_wall_speed=speed, **rates)[length]
        yield Check(
            f"share of diverged episodes, {name}",
            run["diverged"] / num,
            (0.0, 0.0) if name in SHIPPED else None,
            "own criterion",
            resolution=f"{num} episodes",
            note=(
                f"Largest speed {run['fastest']:.2f} nodes per step. With no divergence in "
                f"{num} episodes, the share is below {3.0 / num:.3f} at 95 % confidence."
            ),
        )
    shares = {f"energy {e:g}, flux {f:g}": share for (e, f), share in _read_shares(runs).items()}
    name = "share of diverged episodes at the paper's speed, by collision rates"
    at = f"energy {DEFAULT.energy:g}, flux {DEFAULT.flux:g}"
    yield check_refined("", name, shares, at=at, resolution="L = 50")
    fates = [
        fate
        for d, u in product(DIAMETERS, SPEEDS)
        for fate in runs.read("fate", "reynolds", diameter=d, speed=u).values()
    ]
    name = "impulsively started cylinders that diverge, of those accepted"
    accepted = f"of {len(fates) - fates.count(REFUSED)}"
    yield Check(name, float(fates.count(DIVERGED)), resolution=accepted)


def draw(figure: Figure, runs: Runs) -> None:
    """Draw both maps."""
    grid = figure.add_gridspec(2, len(DIAMETERS))
    _draw_rates(figure.add_subplot(grid[0, :]), _read_shares(runs))
    for i, diameter in enumerate(DIAMETERS):
        axes = figure.add_subplot(grid[1, i])
        for fate, (colour, marker) in MARKS.items():
            found = [
                (reynolds, speed)
                for speed in SPEEDS
                for reynolds, run in runs.by("reynolds", diameter=diameter, speed=speed).items()
                if run["fate"] == fate
            ]
            places = [re for re, _ in found], [u for _, u in found]
            axes.scatter(*places, s=150, color=colour, marker=marker, label=fate)
        axes.set_xscale("log")
        name_ticks(axes, CYLINDER_REYNOLDS)
        axes.set(xlabel="U D / ν", ylim=(0.02, 0.22), xlim=(60, 11000))
        axes.set(title=f"cylinder, D = {diameter}", ylabel="" if i else "stream  U, nodes per step")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=3)


def _draw_rates(axes: Axes, table: Mapping[tuple[float, float], float]) -> None:
    shares = [[table[e, f] for e in ENERGIES] for f in FLUXES]
    axes.imshow(shares, cmap="Reds", vmin=0.0, vmax=1.0, origin="lower", aspect="auto")
    for i, row in enumerate(shares):
        for j, share in enumerate(row):
            shade = "white" if share > 0.6 else "black"
            axes.text(j, i, f"{100 * share:.0f} %", ha="center", va="center", color=shade)
    axes.set_xticks(range(len(ENERGIES)), [f"{e:g}" for e in ENERGIES])
    axes.set_yticks(range(len(FLUXES)), [f"{f:g}" for f in FLUXES])
    axes.set(
        xlabel="relaxation rate of the energy  s_e",
        ylabel="rate of the flux  s_q",
        title=f"diverged episodes of {NUM_EPISODES}, L = 50, tail at {PAPER_SPEED:.3f}",
    )


SOURCE = "own criterion: of the episodes tried in a shipped preset, none diverges"
CASE = Case("stability", __doc__, SOURCE, JOBS, judge, draw, size=(11.0, 6.4))
