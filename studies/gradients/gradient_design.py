"""A C-start by gradient against CMA-ES at equal flow steps: ``python examples/gradient_design.py``.

Eight numbers set the strokes of a larva: bend and wave at three points, delay and phase. Adam and
L-BFGS-B go along the gradient, CMA-ES samples. A gradient costs two motions: forward and back.
"""

import argparse
import math
import resource
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import scipy.optimize
import torch
from torch import Tensor

from fishrl.extras import show_install
from fishrl.physics import (
    C_START,
    Boundaries,
    Fish,
    FlowConfig,
    FlowState,
    Free,
    NoSlip,
    Section,
    simulate,
)
from fishrl.physics.bodies.state import make_body
from fishrl.physics.flow import make_params, make_rest

LOW = torch.tensor([-2.0 * math.pi] * 6 + [0.0, 0.0]).double()
HIGH = torch.tensor([0.0] * 6 + [1.0, 2.0 * math.pi]).double()
FIRST = C_START.sequence[0]
PUBLISHED = (torch.tensor([*FIRST.bend, *FIRST.wave, FIRST.lag, C_START.phase]) - LOW) / (
    HIGH - LOW
)
SIGMA = 0.1  # of starts around the published strokes, and of CMA-ES, parts of the bounds' distance


@dataclass(frozen=True, kw_only=True)
class Escape:
    """A larva in a closed tank, as on the page on the C-start but coarser.

    Args:
        body_length: L in nodes.
        tank_bl: side of the tank, L.
        reynolds: L^2 / (nu T).
        period_bl: T in steps per node of L.
        duration_T: duration of the motion.
        penalty: loss of score, L, per squared relative excess of work over the published strokes.
        compile: compile the step.
    """

    body_length: int = 16
    tank_bl: float = 3.0
    reynolds: float = 550.0
    period_bl: int = 25
    duration_T: float = 2.7
    penalty: float = 2.0
    compile: bool = True

    @property
    def num_steps(self) -> int:
        """Steps of one motion."""
        return round(self.duration_T * self.period_bl * self.body_length)

    def swim(self, numbers: Tensor) -> tuple[Tensor, Tensor]:
        """Return distance, L, and work, rho L^4 / T^2, of strokes ``[8]``, parts of the bounds."""
        length, period = self.body_length, self.period_bl * self.body_length
        wall, side = NoSlip(), round(self.tank_bl * length)
        larva = Fish(
            body_length=length,
            section=Section.LARVA,
            thickness=0.127,
            strokes=C_START,
            motion=Free(),
        )
        config = FlowConfig(
            width=side,
            height=side,
            tau=3.0 * length**2 / (self.reynolds * period) + 0.5,
            bodies=(larva,),
            boundaries=Boundaries(left=wall, right=wall, bottom=wall, top=wall),
        )
        params = make_params([config])
        values = (LOW + numbers * (HIGH - LOW))[None]
        back = torch.cat((-values[:, :3], torch.zeros(1, 4)), 1)
        (own,) = params.bodies
        change = torch.stack((values[:, :7], back), 1)
        curve = own.curve._replace(change=change, phase=values[:, 7])
        params = params._replace(bodies=(own._replace(curve=curve),))
        one = torch.ones(1, dtype=torch.float64)
        middle = torch.full((1, 2), 0.5 * (side - 1), dtype=torch.float64)
        state, _ = simulate(
            FlowState(
                make_rest(config, 1, torch.float32),
                (make_body(middle, math.pi * one, one / period),),
            ),
            config,
            params,
            num_steps=self.num_steps,
            segment=self.num_steps,  # keeps all steps: none is made twice
            compile=self.compile,
        )
        (body,) = state.bodies
        distance = (body.position - middle).norm(dim=1)[0] / length
        return distance, body.work[0] * period**2 / length**4

    @cached_property
    def published(self) -> tuple[float, float]:
        """Distance and work of the published strokes."""
        with torch.no_grad():
            distance, work = self.swim(PUBLISHED)
        return float(distance), float(work)

    def score(self, numbers: Tensor) -> Tensor:
        """Return distance less penalty; smooth in the work."""
        distance, work = self.swim(numbers)
        excess = (work / self.published[1] - 1.0).clamp_min(0.0)
        return distance - self.penalty * excess.square()


class Exhausted(Exception):
    """No flow steps are left."""


@dataclass
class Meter:
    """Scores of strokes, counted in flow steps.

    Args:
        escape: what is scored.
        budget: flow steps.
    """

    escape: Escape
    budget: int
    steps: int = 0  #: taken
    best: Tensor = PUBLISHED  #: best strokes
    course: list[tuple[int, float]] = field(default_factory=list)  #: steps and best score so far

    def rate(self, numbers: np.ndarray, *, with_slope: bool) -> tuple[float, np.ndarray]:
        """Return score and gradient (zero without ``with_slope``); of a diverged flow -1 and 0."""
        cost = (1 + with_slope) * self.escape.num_steps
        if self.steps + cost > self.budget:
            raise Exhausted
        self.steps += cost
        given = torch.tensor(numbers, dtype=torch.float64, requires_grad=with_slope)
        slope = torch.zeros(8)
        with torch.set_grad_enabled(with_slope):
            score = self.escape.score(given)
        if with_slope:
            (slope,) = torch.autograd.grad(score, given)
        value = float(score.detach().nan_to_num(-1.0))
        if not self.course or value > self.course[-1][1]:
            self.best = given.detach()
        self.course.append((self.steps, max(value, self.course[-1][1] if self.course else value)))
        return value, slope.nan_to_num(0.0).numpy()


def climb(meter: Meter, start: Tensor, number: int) -> None:
    """Adam with rate 0.03, clamped to the bounds."""
    numbers = start.clone().requires_grad_()
    adam = torch.optim.Adam([numbers], lr=0.03)
    while True:
        _, slope = meter.rate(numbers.detach().numpy(), with_slope=True)
        numbers.grad = -torch.tensor(slope).double()
        adam.step()
        numbers.data.clamp_(0.0, 1.0)


def descend(meter: Meter, start: Tensor, number: int) -> None:
    """L-BFGS-B of scipy; in tenths of the bounds' distance, so that its first step is no longer."""

    def loss(tenths: np.ndarray) -> tuple[float, np.ndarray]:
        score, slope = meter.rate(0.1 * tenths, with_slope=True)
        return -score, -0.1 * slope.astype(np.float64)

    begin = 10.0 * start.numpy()
    while True:  # again from the best, with an empty memory, where it has converged or failed
        scipy.optimize.minimize(
            loss,
            begin,
            jac=True,
            method="L-BFGS-B",
            bounds=[(0.0, 10.0)] * 8,
            options={"gtol": 0.0, "ftol": 0.0},  # the budget ends it
        )
        begin = 10.0 * meter.best.numpy()


def evolve(meter: Meter, start: Tensor, number: int) -> None:
    """CMA-ES with eight candidates per generation."""
    try:
        import cmaes
    except ImportError as error:
        raise ImportError(f"the comparison needs cmaes: {show_install('sweep')}") from error
    bounds = np.array([[0.0, 1.0]] * 8)
    search = cmaes.CMA(
        mean=start.numpy(), sigma=SIGMA, bounds=bounds, population_size=8, seed=number
    )
    while True:
        asked = [search.ask() for _ in range(8)]
        search.tell([(one, -meter.rate(one, with_slope=False)[0]) for one in asked])


SEARCHES: dict[str, Callable[[Meter, Tensor, int], None]] = {
    "Adam": climb,
    "L-BFGS-B": descend,
    "CMA-ES": evolve,
}


def scan(escape: Escape, num: int) -> tuple[list[float], list[float], float]:
    """Return shifts of the published strokes along the gradient, their distances, and its norm."""
    numbers = PUBLISHED.clone().requires_grad_()
    (slope,) = torch.autograd.grad(escape.swim(numbers)[0], numbers)
    shifts = torch.linspace(-0.1, 0.1, num).tolist()
    with torch.no_grad():
        along = slope / slope.norm()
        distances = [float(escape.swim(PUBLISHED + shift * along)[0]) for shift in shifts]
    return shifts, distances, float(slope.norm())


def draw(
    path: Path, meters: dict[tuple[str, int], Meter], line: tuple[list[float], list[float], float]
) -> None:
    """Draw best scores against flow steps, and the distance along the gradient."""
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(8.0, 3.0), layout="constrained")
    for (name, number), meter in meters.items():
        steps, scores = zip(*meter.course, strict=True)
        colour = f"C{list(SEARCHES).index(name)}"
        label = None if number else name
        left.step([n / 1e3 for n in steps], scores, colour, where="post", label=label, lw=1.0)
    left.set(xlabel="flow steps  [1000]", ylabel="best score  [L]")
    left.legend(fontsize=8)
    shifts, distances, slope = line
    right.plot(shifts, distances, "k.-", label="distance", markersize=3, lw=0.7)
    middle = distances[len(distances) // 2]
    near = [shift for shift in shifts if abs(shift) < 0.04]
    right.plot(near, [middle + slope * shift for shift in near], "C1", label="gradient")
    right.set(xlabel="shift along the gradient, parts of the bounds", ylabel="distance  [L]")
    right.legend(fontsize=8)
    figure.savefig(path, dpi=110)


def main() -> None:
    """Search, print the tables and draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--gradients", type=int, default=12, help="budget of each search")
    parser.add_argument("--starts", type=int, default=3)
    parser.add_argument("--finer", type=int, default=24, help="body length of the check")
    parser.add_argument("--figure", type=Path, default=Path("gradient_design.png"))
    chosen = parser.parse_args()
    escape, generator = Escape(), torch.Generator().manual_seed(0)
    budget = 2 * chosen.gradients * escape.num_steps
    print(f"published strokes: distance and work {escape.published}", flush=True)
    shift = SIGMA * torch.randn(chosen.starts, 8, generator=generator).double()
    shift[0] = 0.0  # the first start: the published strokes themselves
    starts, meters = (PUBLISHED + shift).clamp(0.0, 1.0), {}
    print("| search | start | flow steps | first score, L | best score, L | CPU s |")
    print("|---|---|---|---|---|---|")
    line = scan(escape, 15)
    for number, start in enumerate(starts):
        for name, search in SEARCHES.items():
            meter, begun = Meter(escape, budget), time.process_time()
            try:
                search(meter, start, number)
            except Exhausted:
                meters[name, number] = meter
            scores = f"{meter.course[0][1]:.3f} | {meter.course[-1][1]:.3f}"
            spent = time.process_time() - begun
            print(f"| {name} | {number} | {meter.steps} | {scores} | {spent:.0f} |", flush=True)
        draw(chosen.figure, meters, line)
    tops = {"published": PUBLISHED}
    for name in SEARCHES:
        own = [meter for (other, _), meter in meters.items() if other == name]
        tops[name] = max(own, key=lambda meter: meter.course[-1][1]).best
    finer = replace(escape, body_length=chosen.finer, compile=False)
    print("| strokes | distance, work | finer: distance, work | numbers |\n|---|---|---|---|")
    for name, numbers in tops.items():
        with torch.no_grad():
            ends = [*escape.swim(numbers), *finer.swim(numbers)]
        cells = ["{:.3f}, {:.3f}".format(*ends[k : k + 2]) for k in (0, 2)]
        values = ", ".join(f"{value:.2f}" for value in (LOW + numbers * (HIGH - LOW)).tolist())
        print(f"| {name} | {' | '.join(cells)} | {values} |", flush=True)
    print(f"{time.process_time():.0f} s of CPU time", end=", ")
    print(f"{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.2f} GB of memory")


if __name__ == "__main__":
    main()
