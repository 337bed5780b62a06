"""How long gradients through the water are useful: ``python examples/gradient_horizon.py``.

A free fish bends in its first beat. The gradient of its later place with respect to that bend is
compared with what a finite change of the bend does, in still water and in a cylinder's wake; and
with a sharp skin, in still water.
"""

import argparse
import math
import resource
import time
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import torch
from torch import Tensor

from fishrl.physics import (
    Bending,
    Boundaries,
    Coupling,
    Cylinder,
    Fish,
    FlowConfig,
    FlowState,
    InPlaceSolver,
    Scales,
    simulate,
)
from fishrl.physics.bodies.state import make_body
from fishrl.physics.flow import make_params, make_rest

BEND = 0.2  # command in the first beat, radians
CHANGES = (0.01, 0.1)  # of it, both ways
STILL = "still water"


@dataclass(frozen=True, kw_only=True)
class Horizon:
    """A fish behind a cylinder of 0.5 L, or in still water.

    Args:
        body_length: L in nodes.
        reynolds: L^2 / (nu T).
        periods: duration in T.
        travels: development time of the wake, D / U.
        skin: coupling of the bodies.
        compile: compile the flow that develops the wake; for the others it would not pay.
    """

    body_length: int = 16
    reynolds: float = 1000.0
    periods: int = 4
    travels: float = 60.0
    skin: Coupling = Coupling.IMPLICIT
    compile: bool = True

    @cached_property
    def scales(self) -> Scales:
        """Units, with the fastest tail allowed."""
        return Scales.from_budget(
            body_length=self.body_length,
            reynolds=self.reynolds,
            max_wall_speed=0.15,
            stream_speed_bl=0.6,
        )

    @cached_property
    def config(self) -> FlowConfig:
        """A domain of 8 L x 4 L with a stream along +x."""
        length, settings = self.body_length, self.skin.body_settings
        fish = Fish(body_length=length, motion=Bending(), **settings)
        return FlowConfig(
            width=8 * length,
            height=4 * length,
            tau=self.scales.tau,
            stream_speed=self.scales.stream_speed,
            boundaries=Boundaries.make_stream(),
            bodies=(fish, Cylinder(diameter=0.5 * length, **settings)),
            coupling=self.skin,
        )

    def develop_wakes(self, num: int) -> list[Tensor]:
        """Return populations ``[1, Q, Y, X]`` of the wake alone, a quarter of its period apart."""
        cylinder = self.config.bodies[1]
        config = replace(self.config, bodies=(cylinder,))
        solver = InPlaceSolver(config=config, compile=self.compile, num_workers=0)
        centre = [[1.5 * self.body_length, 2.03 * self.body_length]]
        every = torch.ones(1, dtype=torch.bool)
        solver.reset_(every, torch.tensor(centre, dtype=torch.float64), velocity=(1.0, 0.0))
        travel, wakes = cylinder.size / config.stream_speed, []  # steps; sheds every 5 of them
        for number in range(num):
            solver.advance_(2 * round(0.5 * travel * (1.25 if number else self.travels)))
            wakes.append(solver.populations().clone())
        return wakes

    def swim(self, bend: Tensor, f: Tensor, stream_speed: float) -> Tensor:
        """Return y in L at the end of each half period, ``[2 * periods]``, for a bend ``[]``."""
        length, half = self.body_length, self.scales.period // 2
        one = torch.ones(1, dtype=torch.float64)
        x = 4.0 if stream_speed else 6.0
        place = torch.tensor([[x * length, 2.0 * length]], dtype=torch.float64)
        fish = make_body(place, math.pi * one, one / self.scales.period)
        fish = fish._replace(turn=bend * one, turn_clock=0.0 * one, turn_steps=2.0 * half * one)
        centre = torch.tensor([[1.5 * length, 2.03 * length]], dtype=torch.float64)
        params = make_params([self.config])._replace(stream_speed=stream_speed * one)
        _, y = simulate(
            FlowState(f, (fish, make_body(centre, 0.0 * one, 0.0 * one))),
            self.config,
            params,
            num_steps=2 * half * self.periods,
            interval=half,
            record=lambda state: state.bodies[0].position[0, 1] / length,
            segment=2 * half * self.periods,  # keeps all steps: many backward passes follow
        )
        assert y is not None
        return y

    def compare(self, f: Tensor, stream_speed: float) -> tuple[Tensor, Tensor]:
        """Return dy/dbend at the end of each T / 2 ``[N]``, and its secants ``[N, changes]``."""
        bend = torch.tensor(BEND, dtype=torch.float64, requires_grad=True)
        y = self.swim(bend, f, stream_speed)
        slope = [torch.autograd.grad(one, bend, retain_graph=True)[0] for one in y]
        del y  # and all steps that it keeps
        with torch.no_grad():
            rise = [
                self.swim(bend + change, f, stream_speed)
                - self.swim(bend - change, f, stream_speed)
                for change in CHANGES
            ]
        return torch.stack(slope), torch.stack(rise, 1) / (2.0 * torch.tensor(CHANGES))


def draw(path: Path, found: dict[str, tuple[Tensor, Tensor]]) -> None:
    """Draw gradients and the errors of their predictions against time."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(8.0, 3.0), layout="constrained")
    for k, (name, (slope, secants)) in enumerate(found.items()):
        time_T = 0.5 * torch.arange(1, len(slope) + 1)
        style = "k" if name == STILL else f"C{k - 1}"
        axes[0].semilogy(time_T, slope.abs(), style, label=name)
        error = (slope[:, None] - secants).abs() / secants.abs()
        for change, values, line in zip(CHANGES, error.T, (":", "-"), strict=True):
            label = f"change of ±{change:g} rad" if name == STILL else None
            axes[1].semilogy(time_T, values, style + line, label=label)
    axes[0].set(xlabel="time  [T]", ylabel="|dy / dbend|  [L / rad]")
    axes[1].set(xlabel="time  [T]", ylabel="relative error of the gradient")
    axes[1].axhline(0.5, color="0.7")
    for one in axes:
        one.legend(fontsize=7)
    figure.savefig(path, dpi=110)


def main() -> None:
    """Compare all flows, print the table and draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--periods", type=int, default=Horizon.periods)
    parser.add_argument("--wakes", type=int, default=1)
    parser.add_argument("--figure", type=Path, default=Path("gradient_horizon.png"))
    chosen = parser.parse_args()
    horizon = Horizon(periods=chosen.periods)
    sharp = replace(horizon, periods=min(3, chosen.periods), skin=Coupling.BOUNCE_BACK)
    rest = make_rest(horizon.config, 1, torch.float32)
    flows = {STILL: (horizon, rest, 0.0), f"{STILL}, sharp skin": (sharp, rest, 0.0)}
    for number, f in enumerate(horizon.develop_wakes(chosen.wakes), 1):
        flows[f"wake {number}"] = horizon, f, horizon.config.stream_speed
    found = {}
    heads = " | ".join(f"error at ±{change:g} rad" for change in CHANGES)
    print(f"| flow | t / T | dy/dbend, L / rad | {heads} |\n|---|---|---|---|---|")
    for name, (own, f, stream_speed) in flows.items():
        slope, secants = found[name] = own.compare(f, stream_speed)
        error = (slope[:, None] - secants).abs() / secants.abs()
        for k in range(1, len(slope), 2):
            errors = " | ".join(f"{value:.2g}" for value in error[k].tolist())
            print(f"| {name} | {(k + 1) / 2:g} | {float(slope[k]):.3g} | {errors} |", flush=True)
    print(f"{round(horizon.scales.period) * chosen.periods} steps", end=", ")
    print(f"{time.process_time():.0f} s of CPU time", end=", ")
    print(f"{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.2f} GB of memory")
    draw(chosen.figure, found)


if __name__ == "__main__":
    main()
