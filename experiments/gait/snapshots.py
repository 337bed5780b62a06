"""One shedding period of the flow around a fish that holds its station."""

from __future__ import annotations

from math import ceil
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from experiments.figures.style import FISH, VORTICITY_LABEL, panels
from experiments.gait.trials import FRAMES, Trial
from fishrl.envs.episodes import run_episodes
from fishrl.physics.diagnostics import compute_vorticity

_NUM_SHOWN = 4
_LIMIT = 15.0  # vorticity at which colours saturate, 1/T

#: Vorticity ``[Y, X]`` in 1/T, outlines ``[N, 2]`` in nodes, time in T.
Moment = tuple[Tensor, list[Tensor], float]


def write_period(
    path: Path, trial: Trial, *, num_decisions: int, periods_T: list[float], seed: int = 0
) -> None:
    """Draw four moments of one shedding period in each flow.

    Args:
        path: of the PNG.
        trial: the policy.
        num_decisions: before the first moment; its episodes must last that long.
        periods_T: shedding period of each flow, T.
        seed: of the starts.
    """
    moments = _record(trial, num_decisions=num_decisions, periods_T=periods_T, seed=seed)
    task, num = trial.task, len(periods_T)
    length, (x, y) = task.body_length, task.origin.tolist()
    size = (12, 2.1 * num + 0.6)
    with panels(path, rows=num, columns=_NUM_SHOWN, size=size, sharex=True, sharey=True) as grid:
        for row, speed, shown in zip(grid, task.stream.speeds_bl, moments, strict=True):
            for number, (axes, (vorticity, outlines, time)) in enumerate(
                zip(row, shown, strict=True)
            ):
                height, width = vorticity.shape
                edges = (-0.5 - x, width - 0.5 - x, -0.5 - y, height - 0.5 - y)
                image = axes.imshow(
                    vorticity.numpy(), extent=[edge / length for edge in edges], origin="lower",
                    cmap="RdBu_r", vmin=-_LIMIT, vmax=_LIMIT, interpolation="bilinear",
                )  # fmt: skip
                for outline in outlines:
                    axes.fill(*((outline - task.origin) / length).numpy().T, color=FISH)
                axes.set(xlim=(-0.6, 4.4), ylim=(-1.2, 1.2))
                part = f"{number}/{_NUM_SHOWN} of the period, t = {time:.1f} T"
                axes.set_title(f"{speed:g} L/T, {part}", fontsize=8.5)
            row[0].set_ylabel("y  [L]")
        for axes in grid[-1]:
            axes.set_xlabel("x behind the disc  [L]")
        grid[0, 0].figure.colorbar(image, ax=grid, label=VORTICITY_LABEL, shrink=0.8, pad=0.01)


def _record(
    trial: Trial, *, num_decisions: int, periods_T: list[float], seed: int
) -> list[list[Moment]]:
    """Return the moments of each flow."""
    task = trial.task
    flows = len(periods_T)
    starts = task.sample_starts(1, torch.Generator().manual_seed(seed))[[0] * flows]
    starts["flow_index"] = torch.arange(flows)
    frames: list[tuple[Tensor, list[Tensor], Tensor]] = []

    def keep(start_of: Tensor, base: Any) -> None:
        solver = base.solver
        vorticity = compute_vorticity(solver.macroscopic()[1]) * task.scales.period
        outlines = [solver.markers(index).clone() for index in range(len(solver.bodies))]
        frames.append((vorticity, outlines, solver.body.age / task.scales.period))

    env = trial.make_env(num_envs=flows, seed=seed)
    num_shown = ceil(max(periods_T) / task.interval_T)
    run_episodes(
        env, trial.make_policy(), starts, max_decisions=num_decisions + num_shown, on_frame=keep
    )
    env.close()
    frames = frames[num_decisions * FRAMES :]
    if len(frames) < num_shown * FRAMES:
        raise ValueError(f"{trial.name}: all episodes end before {num_decisions} decisions")
    return [
        [
            (vorticity[flow], [outline[flow] for outline in outlines], float(time[flow]))
            for vorticity, outlines, time in (
                frames[round(k * FRAMES * period / task.interval_T / _NUM_SHOWN)]
                for k in range(_NUM_SHOWN)
            )
        ]
        for flow, period in enumerate(periods_T)
    ]
