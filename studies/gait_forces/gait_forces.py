"""Force on a fish held in a vortex street, by its tail beat: ``python -m experiments.gait_forces``.

The nose stays at a fixed distance behind the half disc and the heading against the stream; the
fish moves sideways freely, apart from a soft support that keeps it on the centreline on average.
Its mean force along the stream says whether a free fish would be carried upstream or swept away,
at each frequency and, at the shedding frequency, at each phase between beat and vortices.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import nan, pi
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from experiments.figures.style import COLOURS
from experiments.gait.diagnostics import find_phase
from experiments.gait.figures import flow_panels
from experiments.gait.trials import check_one_disc
from experiments.pages import write_csv
from experiments.program import TaskSettings, program
from fishrl.bounds import bounded
from fishrl.envs import KarmanGait
from fishrl.envs.starts import place_fish
from fishrl.physics import InPlaceSolver, Towed
from fishrl.training.description import make
from fishrl.training.evaluation import fixed_starts
from fishrl.training.progress import Progress
from fishrl.training.run_folder import write_json

#: Samples per shedding period.
_SAMPLES = 16
#: The lateral support is a PI controller: frequency of its spring, in shedding frequencies, for a
#: mass of rho L^2 (0.79 is that of the water that a plate of length L carries sideways); and time
#: after which the integral term equals it, shedding periods.
_SPRING, _INTEGRAL = 0.25, 4.0


@dataclass(frozen=True, kw_only=True)
class ForceSettings(TaskSettings):
    """Settings of a map of forces.

    Args:
        positions_bl: positions of the nose behind the disc's flat side, body lengths.
        ratios: tail-beat frequencies in units of the shedding frequency.
        num_phases: phases of the tail beat at the start, evenly spaced, for each.
        settling: shedding periods before the measurement.
        periods: shedding periods that are measured.
        folder: folder for table, settings and figure.
    """

    positions_bl: tuple[float, ...] = bounded((0.8, 1.2, 1.6, 2.0, 3.0), greater=0, entries=1)
    ratios: tuple[float, ...] = bounded((0.0, 0.5, 0.85, 1.0, 1.15, 1.5, 2.0), least=0)
    num_phases: int = bounded(4, least=1)
    settling: int = bounded(6, least=1)
    periods: int = bounded(8, least=2)
    folder: str = "runs/gait_forces"


def hold(
    task: KarmanGait, flow: int, settings: ForceSettings, progress: Progress
) -> list[dict[str, float]]:
    """Return the mean force at every position, frequency and phase in one stream.

    ``force_x`` is positive downstream, in rho L (L / T)^2; ``spread`` is the standard deviation of
    its means over single shedding periods, ``lag`` the mean phase of the beat behind that of the
    lift on the disc, ``lock`` the length of that mean; ``y_bl`` and ``sway`` are in L, ``work`` is
    per T.
    """
    assert task.wakes is not None
    cases = list(product(settings.positions_bl, settings.ratios, range(settings.num_phases)))
    x, ratio, start = torch.tensor(cases, dtype=torch.float64).T
    size, period = task.body_length, task.scales.period
    shedding = float(task.wakes.shedding_frequencies[flow])
    fish = replace(task.fish, motion=Towed())
    config = task.flow_config()
    config = replace(config, bodies=(fish, *config.bodies[1:]))
    solver = InPlaceSolver(config=config, num_envs=len(cases), frequency=ratio * shedding)
    starts = fixed_starts(task, len(cases), seed=0)
    starts["head"] = x.new_tensor(task.origin) + size * torch.stack((x, torch.zeros_like(x)), -1)
    starts["flow_index"].fill_(flow)
    every, place = torch.ones(len(cases), dtype=torch.bool), place_fish(starts, fish)
    task.stream.begin_(solver, every, starts, place, scales=task.scales, wakes=task.wakes)
    solver.body.phase.copy_(2.0 * pi * start / settings.num_phases)
    stiffness = size**2 * (2.0 * pi * _SPRING * shedding) ** 2
    interval = 2 * round(0.5 / (_SAMPLES * shedding))
    samples: list[tuple[Tensor, ...]] = []
    offset_sum = torch.zeros_like(x)
    num_samples = _SAMPLES * (settings.settling + settings.periods)
    progress.start(f"{task.stream.speeds_bl[flow]:g} L/T", total=num_samples)
    for sample in range(num_samples + 1):
        body, disc = solver.bodies
        aside = body.position[:, 1] - place[0][:, 1]
        offset_sum += aside / (_SAMPLES * _INTEGRAL)
        body.load[:, 1] = -stiffness * (aside + offset_sum)
        if sample >= _SAMPLES * settings.settling:
            values = (body.impulse[:, 0], disc.impulse[:, 1], body.phase, aside / size, body.work)
            samples.append(tuple(value.clone() for value in values))
        if sample < num_samples:
            solver.advance_(interval)
            progress.advance(1)
    diverged = solver.is_diverged()
    solver.close()
    series = (torch.stack(values, 1).numpy() for values in zip(*samples, strict=True))
    impulse, lift, beat, y, work = series
    unit = size * (size / period) ** 2
    force = np.diff(impulse, axis=1).reshape(len(cases), -1, _SAMPLES).mean(-1) / (interval * unit)
    apart = compare_phases(lift, beat, ratio.numpy(), interval=interval, shedding=shedding)
    measured_T = _SAMPLES * settings.periods * interval / period
    columns: dict[str, Any] = {
        "stream_speed_bl": np.full(len(cases), task.stream.speeds_bl[flow]),
        "x_bl": x,
        "ratio": ratio,
        "force_x": force.mean(1),
        "spread": force.std(1, ddof=1),
        "lag": np.angle(apart),
        "lock": np.abs(apart),
        "y_bl": y.mean(1),
        "sway": y.std(1) * 2.0**0.5,
        "work": (work[:, -1] - work[:, 0]) / (measured_T * unit * size),
        "diverged": diverged,
    }
    return [
        dict(zip(columns, map(float, row), strict=True))
        for row in zip(*columns.values(), strict=True)
    ]


def compare_phases(
    lift: NDArray[np.float64],
    beat: NDArray[np.float64],
    ratio: NDArray[np.float64],
    *,
    interval: float,
    shedding: float,
) -> NDArray[np.complex128]:
    """Return the mean of exp(i lead) of the lift over the beat ``[E]``.

    ``lift`` is the impulse so far and ``beat`` the phase of the tail beat in radians, ``[E, N]``,
    every ``interval`` steps; ``shedding`` is a frequency per step, and ``ratio`` ``[E]`` that of
    the tail beat over it.
    """
    phase = find_phase(np.diff(lift, axis=1), shedding, 1.0 / interval)
    middle = beat[:, 1:] - pi * interval * shedding * ratio[:, None]  # as the mean force is
    return np.asarray(np.exp(1j * (phase - middle)).mean(1))


def find_thrust_phase(rows: Sequence[Mapping[str, float]]) -> float:
    """Return the ``lag`` of greatest thrust, from a fit of mean and sine; NaN where lags are alike.

    ``rows`` are those of ``hold`` at one place and at the shedding frequency.
    """
    lag = np.array([row["lag"] for row in rows])
    if min(row["lock"] for row in rows) < 0.7 or np.abs(np.exp(1j * lag).mean()) > 0.7:
        return nan
    terms = np.stack([np.ones_like(lag), np.cos(lag), np.sin(lag)], -1)
    (_, along, across), *_ = np.linalg.lstsq(terms, np.array([row["force_x"] for row in rows]))
    return float(np.arctan2(-across, -along) % (2.0 * pi))


def draw(path: Path, table: list[dict[str, float]], settings: ForceSettings) -> None:
    """Draw force against frequency (top), and against phase at the shedding frequency (bottom)."""
    speeds = sorted({row["stream_speed_bl"] for row in table})
    with flow_panels(path, speeds, height=6.0, rows=2, sharey="row") as grid:
        for at, speed in enumerate(speeds):
            for number, position in enumerate(settings.positions_bl):
                mine = [r for r in table if r["stream_speed_bl"] == speed and r["x_bl"] == position]
                style: dict[str, Any] = {
                    "color": COLOURS[number % len(COLOURS)],
                    "label": f"nose {position:g} L behind the disc",
                }
                means, errors = [], []
                for ratio in settings.ratios:
                    force = [row["force_x"] for row in mine if row["ratio"] == ratio]
                    means.append(np.mean(force))
                    errors.append(np.std(force))
                grid[0, at].errorbar(
                    settings.ratios, means, errors, marker="o", markersize=3, capsize=2, **style
                )
                locked = sorted(
                    (row["lag"] * 180.0 / pi, row["force_x"])
                    for row in mine
                    if row["ratio"] == 1.0 and row["lock"] > 0.7
                )
                if locked:
                    grid[1, at].plot(*zip(*locked, strict=True), "o-", markersize=3, **style)
            for axes in grid[:, at]:
                axes.axhline(0.0, color="#555555", linewidth=0.8)
            grid[0, at].set_xlabel("tail beat / shedding frequency")
            grid[1, at].set_xlabel("phase of the lift ahead of the beat  [°]")
        for axes in grid[:, 0]:
            axes.set_ylabel("force  [ρ L (L/T)²]   (up: downstream)")
        lines = grid[0, 0].get_legend_handles_labels()
        grid[0, 0].figure.legend(*lines, loc="outside lower center", ncols=3, fontsize=8)


@program(ForceSettings, groups={"task": "karman_gait", "preset": "gait_small"})
def main(settings: ForceSettings) -> None:
    """Measure, write and draw."""
    task, folder = make(settings.task, kind=KarmanGait), Path(settings.folder)
    check_one_disc(task)
    if task.wakes is None:
        raise ValueError("task.stream.has_disc=false: in a free stream no vortices are shed")
    folder.mkdir(parents=True, exist_ok=True)
    table = []
    with Progress() as progress:
        for flow in range(len(task.stream.speeds_bl)):
            table += hold(task, flow, settings, progress)
    numbers = ([float(f"{v:.4g}") for v in row.values()] for row in table)
    write_csv(folder / "forces.csv", list(table[0]), numbers)
    scales = task.scales
    facts = {name: getattr(scales, name) for name in ("body_length", "reynolds", "tau", "mach")}
    num_diverged = int(sum(row["diverged"] for row in table))
    found = {"steps_per_T": scales.period, "rows": len(table), "diverged": num_diverged}
    write_json(folder / "forces.json", facts | found)
    draw(folder / "forces.png", [row for row in table if not row["diverged"]], settings)
    print(f"written to {folder}: forces.csv, forces.json, forces.png")


if __name__ == "__main__":
    main()
