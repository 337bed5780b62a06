"""One shedding period of the flow around a fish that holds its station."""

from __future__ import annotations

from math import ceil
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import torch
from matplotlib.figure import Figure
from torch import Tensor
from torchrl.envs.utils import ExplorationType, set_exploration_type

from experiments.figures import FISH, STYLE, VORTICITY_LABEL
from experiments.gait.trials import FRAMES, Trial
from fishrl.envs import make_env
from fishrl.physics.diagnostics import compute_vorticity

_NUM_SHOWN = 4
_LIMIT = 15.0  # vorticity at which colours saturate, 1/T


def write_period(
    path: Path, trial: Trial, *, num_decisions: int, periods_T: list[float], seed: int = 0
) -> None:
    """Draw four moments of one shedding period in each flow, after a while in it.

    Args:
        path: of the PNG.
        trial: the fish.
        num_decisions: that it swims before; a fish whose episode has ended by then stands still.
        periods_T: shedding period of each flow, T.
        seed: of the starts.
    """
    moments = _record(trial, num_decisions=num_decisions, periods_T=periods_T, seed=seed)
    task = trial.task
    length, origin = task.body_length, task.origin.numpy()
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(12, 2.1 * len(periods_T) + 0.6), layout="constrained")
        grid = figure.subplots(len(periods_T), _NUM_SHOWN, sharex=True, sharey=True, squeeze=False)
        for row, speed, shown in zip(grid, task.stream.speeds_bl, moments, strict=True):
            for number, (axes, (vorticity, outlines, time)) in enumerate(
                zip(row, shown, strict=True)
            ):
                height, width = vorticity.shape
                left, low = (np.array([-0.5, -0.5]) - origin) / length
                right, high = (np.array([width - 0.5, height - 0.5]) - origin) / length
                axes.imshow(
                    vorticity.numpy(), extent=(left, right, low, high), origin="lower",
                    cmap="RdBu_r", vmin=-_LIMIT, vmax=_LIMIT, interpolation="bilinear",
                )  # fmt: skip
                for outline in outlines:
                    axes.fill(*((outline.numpy() - origin) / length).T, color=FISH)
                axes.set(xlim=(-0.6, 4.4), ylim=(-1.2, 1.2))
                part = f"{number}/{_NUM_SHOWN} of the period, t = {time:.1f} T"
                axes.set_title(f"{speed:g} L/T, {part}", fontsize=8.5)
            row[0].set_ylabel("y  [L]")
        for axes in grid[-1]:
            axes.set_xlabel("x behind the disc  [L]")
        figure.colorbar(grid[0][0].images[0], ax=grid, label=VORTICITY_LABEL, shrink=0.8, pad=0.01)
        figure.savefig(path)


def _record(
    trial: Trial, *, num_decisions: int, periods_T: list[float], seed: int
) -> list[list[tuple[Tensor, list[Tensor], float]]]:
    """Return per flow the moments: vorticity ``[Y, X]`` in 1/T, outlines ``[N, 2]``, time in T."""
    task = trial.task
    flows = len(periods_T)
    starts = task.sample_starts(1, torch.Generator().manual_seed(seed))
    starts = starts[[0] * flows]
    starts["flow_index"] = torch.arange(flows)
    frames: list[tuple[Tensor, list[Tensor], Tensor]] = []

    def look(base: Any) -> None:
        solver = base.solver
        vorticity = compute_vorticity(solver.macroscopic()[1]) * task.scales.period
        outlines = [solver.markers(index).clone() for index in range(len(solver.bodies))]
        frames.append((vorticity, outlines, solver.body.age / task.scales.period))

    env = trial.recognition.equip(make_env)(
        task=task, num_envs=flows, seed=seed, starts=starts, frames_per_action=FRAMES
    )
    policy = trial.make_policy()
    num_shown = ceil(max(periods_T) / task.interval_T)
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        state = env.reset()
        for number in range(num_decisions + num_shown):
            if number == num_decisions:
                env.base_env.on_frame = look
            after = env.step(policy(state))["next"]
            state = after.exclude("reward", "done", "terminated", "truncated")
    env.close()
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
