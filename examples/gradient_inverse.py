"""Viscosity and gait of a recorded fish from its path: ``python examples/gradient_inverse.py``.

Levenberg-Marquardt on the path of the centre of mass. The Jacobian comes from one forward-mode
derivative of a batch: row k of the flows carries the derivative with respect to number k.
"""

import argparse
import math
import resource
import time
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from fishrl.physics import Fish, FlowState, Free, Scales, simulate
from fishrl.physics.bodies.state import make_body
from fishrl.physics.cases import make_swimmer_config
from fishrl.physics.flow import make_params, make_rest

NAMES = ("viscosity", "frequency", "amplitude")


@dataclass(frozen=True, kw_only=True)
class Recording:
    """A free fish that starts from rest in a closed tank of 4 L x 3 L.

    Args:
        body_length: L in nodes.
        reynolds: true L^2 / (nu T).
        periods: duration in T.
        noise: standard deviation of the recorded places, L.
        seed: of the noise.
    """

    body_length: int = 16
    reynolds: float = 300.0
    periods: float = 2.0
    noise: float = 0.002
    seed: int = 0

    @property
    def scales(self) -> Scales:
        """Units of the true fish."""
        return Scales.from_budget(
            body_length=self.body_length, reynolds=self.reynolds, max_wall_speed=0.15
        )

    @property
    def num_steps(self) -> int:
        """Steps of the recording."""
        return 8 * round(self.periods * self.scales.period / 8)

    def swim(self, factors: Tensor) -> Tensor:
        """Return paths ``[B, 16]`` in L: x and y at eight times.

        ``factors`` ``[B, 3]`` multiply the true viscosity, frequency and amplitude.
        """
        scales, length, num = self.scales, self.body_length, len(factors)
        viscosity, frequency, amplitude = factors.unbind(1)
        fish = Fish(body_length=length, motion=Free())
        config = make_swimmer_config(scales, length_bl=4, height_bl=3, bodies=(fish,))
        params = make_params([config] * num)._replace(tau=3.0 * scales.nu * viscosity + 0.5)
        one = torch.ones_like(viscosity)
        place = torch.stack((2.0 * length * one, 1.5 * length * one), 1)
        body = make_body(place, math.pi * one, frequency / scales.period)
        body = body._replace(amplitude=amplitude, amplitude_goal=amplitude)
        _, path = simulate(
            FlowState(make_rest(config, num), (body,)),
            config,
            params,
            num_steps=self.num_steps,
            interval=self.num_steps // 8,
            record=lambda state: (state.bodies[0].position - place) / length,
        )
        assert path is not None
        return path.transpose(0, 1).flatten(1)


def fit(recording: Recording, path: Tensor, guess: Tensor, num_iterations: int) -> list[Tensor]:
    """Return the factors ``[3]`` of each iteration, the guess first, and print them."""
    log, damping, best = guess.log(), 1e-3, math.inf
    course, slopes, errors = [], torch.zeros(len(path), 3), path
    for number in range(num_iterations + 1):
        rows = log.expand(3, 3)
        paths, tangents = torch.func.jvp(
            lambda log: recording.swim(log.exp()), (rows,), (torch.eye(3, dtype=log.dtype),)
        )
        square = float((paths[0] - path).square().mean())
        if square < best:
            best, base, slopes, errors = square, log, tangents.T, paths[0] - path
            damping *= 0.1
        else:
            damping *= 30.0
        course.append(base.exp())
        error = " | ".join(f"{value:+.4f}" for value in (base.exp() - 1.0).tolist())
        print(f"| {number} | {math.sqrt(best):.2e} | {error} | {time.process_time():.0f} |")
        normal = slopes.T @ slopes
        log = base - torch.linalg.solve(
            normal + damping * torch.diag(normal.diagonal()), slopes.T @ errors
        )
    return course


def draw(path: Path, recording: Recording, paths: dict[str, Tensor], course: list[Tensor]) -> None:
    """Draw the paths, and the relative errors of the numbers."""
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(8.0, 3.0), layout="constrained")
    for (name, values), style in zip(paths.items(), ("ko", "C1--", "C0-"), strict=True):
        left.plot(*values.view(8, 2).T, style, label=name, markersize=4)
    left.set(xlabel="x  [L]", ylabel="y  [L]")
    for name, values in zip(NAMES, torch.stack(course).T, strict=True):
        right.semilogy((values - 1.0).abs().clamp_min(1e-9), "o-", label=name, markersize=3)
    right.set(xlabel="iteration", ylabel="relative error")
    for one in (left, right):
        one.legend(fontsize=8)
    figure.savefig(path, dpi=110)


def main() -> None:
    """Record, fit, print the table and draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--iterations", type=int, default=8)
    parser.add_argument("--noise", type=float, default=Recording.noise)
    parser.add_argument("--figure", type=Path, default=Path("gradient_inverse.png"))
    chosen = parser.parse_args()
    recording = Recording(noise=chosen.noise)
    truth, guess = torch.ones(1, 3).double(), torch.tensor([1.5, 0.9, 0.8]).double()
    generator = torch.Generator().manual_seed(recording.seed)
    with torch.no_grad():
        ideal = recording.swim(truth)[0]
        path = ideal + recording.noise * torch.randn(len(ideal), generator=generator)
        print(f"| iteration | rms error, L | {' | '.join(NAMES)} | CPU s |")
        course = fit(recording, path, guess, chosen.iterations)
        ends = recording.swim(torch.stack((guess, course[-1])))
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    print(f"{recording.num_steps} steps per path, {memory:.2f} GB of memory")
    draw(chosen.figure, recording, {"recorded": path, "guess": ends[0], "fit": ends[1]}, course)


if __name__ == "__main__":
    main()
