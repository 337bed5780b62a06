"""Viscosity and gait of a recorded fish: ``python examples/gradient_inverse.py``.

Levenberg-Marquardt on place, heading and two velocity probes at some times. All recordings are
fitted in one batch of flows, and the Jacobian comes from one backward pass per number observed.
"""

import argparse
import math
import resource
import time
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

from fishrl.physics import Fish, FlowState, Free, ImmersedBoundary, Scales, simulate
from fishrl.physics.bodies.state import make_body
from fishrl.physics.cases import make_swimmer_config
from fishrl.physics.collision import compute_macroscopic
from fishrl.physics.flow import make_params, make_rest

NAMES = ("viscosity", "frequency", "amplitude")
GUESS = (1.5, 0.9, 0.8)  # of the true ones
PROBES = ((0.9, 0.0), (0.0, 0.3))  # places from the fish's start, L, behind it and at its side
#: Standard deviations: x and y, L; heading, radians; both velocities at each probe, L / T.
NOISE = (0.002, 0.002, 0.003, *(0.01,) * 4)
LARGEST = 0.3  # of a step, in the logarithm of each number


@dataclass(frozen=True, kw_only=True)
class Recording:
    """A free fish that starts from rest in a closed tank of 4 L x 3 L.

    Args:
        body_length: L in nodes.
        reynolds: true L^2 / (nu T).
        periods: duration in T.
        times: number of observations, evenly spaced.
        compile: compile the step.
    """

    body_length: int = 16
    reynolds: float = 50.0
    periods: float = 3.0
    times: int = 6
    compile: bool = True

    @property
    def scales(self) -> Scales:
        """Units of the true fish."""
        return Scales.from_budget(
            body_length=self.body_length, reynolds=self.reynolds, max_wall_speed=0.15
        )

    @property
    def num_steps(self) -> int:
        """Steps of a recording."""
        return self.times * round(self.periods * self.scales.period / self.times)

    def swim(self, factors: Tensor) -> Tensor:
        """Return all that is observed over ``NOISE``, ``[B, 7 * times]``.

        ``factors`` ``[B, 3]`` multiply the true viscosity, frequency and amplitude.
        """
        scales, length, num = self.scales, self.body_length, len(factors)
        viscosity, frequency, amplitude = factors.unbind(1)
        fish = Fish(body_length=length, motion=Free())  # the immersed boundary is smooth
        config = make_swimmer_config(
            scales, length_bl=4, height_bl=3, bodies=(fish,), skin=ImmersedBoundary()
        )
        params = make_params([config] * num)._replace(tau=3.0 * scales.nu * viscosity + 0.5)
        one = torch.ones_like(viscosity)
        place = torch.stack((2.0 * length * one, 1.5 * length * one), 1)
        body = make_body(place, math.pi * one, frequency / scales.period)
        body = body._replace(amplitude=amplitude, amplitude_goal=amplitude)
        noise = factors.new_tensor(NOISE)

        def observe(state: FlowState) -> Tensor:
            (body,) = state.bodies
            moved, fluid = (body.position - place) / length, compute_macroscopic(state.f.unbind(1))
            speeds = [
                u[:, round((1.5 + y) * length), round((2.0 + x) * length)]
                for x, y in PROBES
                for u in (fluid.ux, fluid.uy)
            ]
            probes = torch.stack(speeds, 1) * (scales.period / length)
            return torch.cat((moved, body.heading[:, None] - math.pi, probes), 1) / noise

        _, seen = simulate(
            FlowState(make_rest(config, num, torch.float32), (body,)),
            config,
            params,
            num_steps=self.num_steps,
            interval=self.num_steps // self.times,
            record=observe,
            segment=self.num_steps,  # keeps all steps: many backward passes follow
            compile=self.compile,
        )
        assert seen is not None
        return seen.transpose(0, 1).flatten(1)

    def linearise(self, log: Tensor) -> tuple[Tensor, Tensor]:
        """Return ``swim(log.exp())`` and its Jacobian ``[B, 7 * times, 3]``."""
        log = log.detach().requires_grad_()
        seen = self.swim(log.exp())
        slopes = [
            torch.autograd.grad(one.sum(), log, retain_graph=True)[0] for one in seen.unbind(1)
        ]
        return seen.detach(), torch.stack(slopes, 1)


def fit(recording: Recording, data: Tensor, num_iterations: int) -> tuple[Tensor, Tensor]:
    """Fit all recordings ``data`` ``[B, 7 * times]``.

    Returns:
        Factors after each iteration, ``[iterations + 1, B, 3]``, the guess first, and the Jacobian
        with respect to their logarithms at the last.
    """
    log = torch.tensor(GUESS).double().log().expand(len(data), 3)
    damping, course = torch.full((len(data), 1, 1), 1e-3).double(), [log]
    seen, slopes = recording.linearise(log)
    for _ in range(num_iterations):
        normal = slopes.mT @ slopes
        # by the stiffest direction: the viscosity, which changes least, waits for the others
        stiffest = normal.diagonal(dim1=1, dim2=2).amax(1)[:, None, None]
        damped = normal + damping * stiffest * torch.eye(3)
        step = torch.linalg.solve(damped, slopes.mT @ (data - seen)[:, :, None])[..., 0]
        step = step * (LARGEST / step.abs().amax(1, keepdim=True)).clamp(max=1.0)
        next_seen, next_slopes = recording.linearise(log + step)
        is_better = (next_seen - data).square().sum(1) < (seen - data).square().sum(1)
        log = torch.where(is_better[:, None], log + step, log)
        seen = torch.where(is_better[:, None], next_seen, seen)
        slopes = torch.where(is_better[:, None, None], next_slopes, slopes)
        damping = damping * torch.where(is_better, 0.1, 10.0)[:, None, None]
        course.append(log)
    return torch.stack(course).exp(), slopes


def draw(path: Path, paths: dict[str, Tensor], course: Tensor) -> None:
    """Draw paths, and the relative errors of the numbers in each iteration."""
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(8.0, 3.0), layout="constrained")
    for (name, values), style in zip(paths.items(), ("ko", "C1--", "C0-"), strict=True):
        x, y, *_ = (values.view(-1, len(NOISE)) * torch.tensor(NOISE)).T
        left.plot(x, y, style, label=name, markersize=4)
    left.set(xlabel="x  [L]", ylabel="y  [L]")
    left.legend(fontsize=8)
    styles = ("-", "--", "--", "--", ":")
    for row, style in enumerate(styles[: course.shape[1]]):
        for k, number in enumerate(NAMES):
            error = (course[:, row, k] - 1.0).abs().clamp_min(1e-7)
            label = number if row == 0 else None
            right.semilogy(error, style, color=f"C{k}", label=label, linewidth=1.0)
    right.set(xlabel="iteration", ylabel="relative error")
    right.legend(fontsize=8)
    figure.savefig(path, dpi=110)


def main() -> None:
    """Record, fit, print the table and draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--iterations", type=int, default=6)
    parser.add_argument("--figure", type=Path, default=Path("gradient_inverse.png"))
    chosen = parser.parse_args()
    recording, generator = Recording(), torch.Generator().manual_seed(0)
    truth = torch.ones(1, 3).double()
    with torch.no_grad():
        ideal = replace(recording, compile=False).swim(truth)
        finer = replace(recording, body_length=32, compile=False).swim(truth)
    noise = torch.randn(3, ideal.shape[1], generator=generator).double()
    data = torch.cat((ideal, ideal + noise, finer))
    names = ["no noise", "noise 1", "noise 2", "noise 3", "recorded at L = 32"]
    course, slopes = fit(recording, data, chosen.iterations)
    bars = torch.linalg.inv(slopes.mT @ slopes).diagonal(dim1=1, dim2=2).sqrt()
    print(f"| recording | {' | '.join(NAMES)} |\n|---|---|---|---|")
    for name, found, bar in zip(names, course[-1], bars, strict=True):
        cells = zip((found - 1.0).tolist(), bar.tolist(), strict=True)
        print(f"| {name} | {' | '.join(f'{v:+.2%} (± {b:.2%})' for v, b in cells)} |")
    print("singular values of the Jacobian:", torch.linalg.svdvals(slopes[0]).tolist())
    print(f"{recording.num_steps} steps, {time.process_time():.0f} s of CPU time", end=", ")
    print(f"{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.2f} GB of memory")
    with torch.no_grad():
        ends = replace(recording, compile=False).swim(course[[0, -1], 1])
    draw(chosen.figure, {"noise 1": data[1], "guess": ends[0], "fit": ends[1]}, course)


if __name__ == "__main__":
    main()
