"""How long gradients through the water are useful: ``python examples/gradient_horizon.py``.

A free fish bends in its first beat. The gradient of its later place with respect to that bend is
compared with what a small and a large change of the bend really do, in still water and in a wake.
"""

import argparse
import math
import resource
import time
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

from fishrl.physics import (
    Bending,
    Boundaries,
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

CHANGES = (1e-4, 0.01, 0.1)  #: of the bend command, radians


@dataclass(frozen=True, kw_only=True)
class Horizon:
    """What is simulated.

    Args:
        body_length: L in nodes.
        reynolds: L^2 / (nu T).
        periods: duration in T.
        travels: development time of the wake, D / U.
        compile: compile the flow that develops the wake.
    """

    body_length: int = 16
    reynolds: float = 1000.0
    periods: int = 6
    travels: int = 60
    compile: bool = True

    @property
    def scales(self) -> Scales:
        """Units, with the fastest tail allowed."""
        length = self.body_length
        return Scales.from_budget(
            body_length=length, reynolds=self.reynolds, max_wall_speed=0.15, stream_speed_bl=0.4
        )

    def make_config(self, *, has_stream: bool) -> FlowConfig:
        """Return a tank of 8 L x 4 L, with walls or with a stream and a cylinder of 0.75 L."""
        length, scales = self.body_length, self.scales
        fish = Fish(body_length=length, motion=Bending())
        config = FlowConfig(width=8 * length, height=4 * length, tau=scales.tau, bodies=(fish,))
        if not has_stream:
            return config
        return replace(
            config,
            bodies=(fish, Cylinder(diameter=0.75 * length)),
            boundaries=Boundaries.make_stream(),
            stream_speed=scales.stream_speed,
        )

    def develop_wake(self, config: FlowConfig) -> Tensor:
        """Return populations ``[1, Q, Y, X]`` of the wake without the fish, float64."""
        cylinder = config.bodies[1]
        solver = InPlaceSolver(
            config=replace(config, bodies=(cylinder,)), compile=self.compile, num_workers=0
        )
        length, steps = self.body_length, round(self.travels * cylinder.size / config.stream_speed)
        every, place = torch.ones(1, dtype=torch.bool), [[1.5 * length, 2.03 * length]]
        solver.reset_(every, torch.tensor(place, dtype=torch.float64), velocity=(1.0, 0.0))
        solver.advance_(2 * (steps // 2))
        return solver.populations().double()

    def compare(self, *, has_stream: bool) -> tuple[Tensor, Tensor]:
        """Return dy/dbend at the end of each T / 4 ``[N]``, and its secants ``[N, changes]``."""
        config, scales = self.make_config(has_stream=has_stream), self.scales
        length, num = self.body_length, 1 + 2 * len(CHANGES)
        one = torch.ones(num, dtype=torch.float64)
        f = self.develop_wake(config).repeat(num, 1, 1, 1) if has_stream else make_rest(config, num)
        place = torch.stack(((4.5 if has_stream else 6.0) * length * one, 2.0 * length * one), 1)
        quarter = scales.period // 4
        bodies = [make_body(place, math.pi * one, one / scales.period)]
        if has_stream:
            centre = torch.stack((1.5 * length * one, 2.03 * length * one), 1)
            bodies.append(make_body(centre, 0.0 * one, 0.0 * one))

        def swim(bend: Tensor) -> Tensor:
            fish = bodies[0]._replace(turn=bend, turn_clock=0.0 * one)
            fish = fish._replace(turn_steps=4.0 * quarter * one)
            state = FlowState(f, (fish, *bodies[1:]))
            _, y = simulate(
                state,
                config,
                make_params([config] * num),
                num_steps=4 * quarter * self.periods,
                interval=quarter,
                record=lambda state: state.bodies[0].position[:, 1] / length,
            )
            assert y is not None
            return y

        change = torch.tensor(CHANGES, dtype=torch.float64)
        bend = 0.2 + torch.cat((torch.zeros(1), change, -change))
        y, slope = torch.func.jvp(swim, (bend,), (one,))  # flows are independent
        n = len(CHANGES)
        return slope[:, 0], (y[:, 1 : n + 1] - y[:, n + 1 :]) / (2.0 * change)


def draw(path: Path, found: dict[str, tuple[Tensor, Tensor]]) -> None:
    """Draw gradients and the errors of their predictions against time."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(9.0, 3.2), layout="constrained")
    for (name, (slope, secants)), style in zip(found.items(), ("-", "--"), strict=True):
        time_T = 0.25 * torch.arange(1, len(slope) + 1)
        axes[0].semilogy(time_T, slope.abs(), style, color="black", label=name)
        error = (slope[:, None] - secants).abs() / secants.abs()
        for change, values, colour in zip(CHANGES, error.T, ("C0", "C1", "C3"), strict=True):
            label = f"{name}, change of {change:g} rad"
            axes[1].semilogy(time_T, values, style, color=colour, label=label)
    axes[0].set(xlabel="time  [T]", ylabel="|dy / dbend|  [L / rad]")
    axes[1].set(xlabel="time  [T]", ylabel="relative error of the prediction")
    axes[1].axhline(0.5, color="0.7")
    for one in axes:
        one.legend(fontsize=7)
    figure.savefig(path, dpi=110)


def main() -> None:
    """Compare both flows, print the table and draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--periods", type=int, default=Horizon.periods)
    parser.add_argument("--figure", type=Path, default=Path("gradient_horizon.png"))
    chosen = parser.parse_args()
    horizon, found = Horizon(periods=chosen.periods), {}
    heads = " | ".join(f"error at {change:g} rad" for change in CHANGES)
    print(f"| flow | t / T | dy/dbend, L / rad | {heads} |")
    for name, has_stream in (("still water", False), ("wake", True)):
        slope, secants = found[name] = horizon.compare(has_stream=has_stream)
        error = (slope[:, None] - secants).abs() / secants.abs()
        for k in range(3, len(slope), 4):
            errors = " | ".join(f"{value:.1e}" for value in error[k].tolist())
            print(f"| {name} | {(k + 1) / 4:g} | {float(slope[k]):.3g} | {errors} |")
    usage = resource.getrusage(resource.RUSAGE_SELF)
    print(f"{time.process_time():.0f} s of CPU time, {usage.ru_maxrss / 1e6:.2f} GB of memory")
    draw(chosen.figure, found)


if __name__ == "__main__":
    main()
