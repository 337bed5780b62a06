"""The Kármán gait in pictures: survival, paths, places, frequencies, angles, work."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import pi
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle, Wedge
from torch import Tensor

from experiments.figures import COLOURS, STYLE, read_metrics
from experiments.gait.histories import Histories
from experiments.validation.convergence import tidy

_MOST_PATHS = 40
#: Width of the bins of a mean of leans, beats, and how many windows each holds at least.
_LEAN_BIN, _LEAST = 0.25, 10

Results = Mapping[str, Sequence[Mapping[str, float]]]
#: Of one fish: its episodes in each flow.
Recorded = Mapping[str, Sequence[Histories]]


def write_survival(
    path: Path,
    lengths: Mapping[str, Sequence[Sequence[Sequence[float]]]],
    *,
    speeds: Sequence[float],
) -> None:
    """Draw how long each kind of fish lasted in each flow: a point per episode, a bar the mean.

    Args:
        path: of the PNG.
        lengths: of each arm, per flow, per seed: durations in T.
        speeds: of the flows, L / T.
    """
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(11, 3.6), layout="constrained")
        grid = figure.subplots(1, len(speeds), sharey=True, squeeze=False)[0]
        generator = np.random.default_rng(0)
        for flow, (axes, speed) in enumerate(zip(grid, speeds, strict=True)):
            for at, flows in enumerate(lengths.values()):
                colour = COLOURS[at % len(COLOURS)]
                for values in flows[flow]:
                    spread = at + generator.uniform(-0.28, 0.28, len(values))
                    axes.plot(spread, values, ".", color=colour, markersize=3, alpha=0.35)
                    axes.hlines(np.mean(values), at - 0.36, at + 0.36, color=colour, linewidth=1.8)
            axes.set(title=f"stream {speed:g} L/T", ylim=(0, None))
            axes.set_xticks(range(len(lengths)), list(lengths), rotation=40, ha="right")
            tidy(axes)
        grid[0].set_ylabel("survival  [T]")
        figure.suptitle("a point per episode, a line per seed: its mean", fontsize=9)
        figure.savefig(path)


def write_training(path: Path, runs: Mapping[str, Sequence[Path]]) -> None:
    """Draw survival and return during training: a line per run, a colour per arm.

    Args:
        path: of the PNG.
        runs: folders of each arm's seeds.
    """
    panels = (
        ("train/episode_length", "survival, mean of 32 episodes  [decisions]"),
        ("train/return", "return, mean of 32 episodes"),
        ("train/loss_actor", "actor loss"),
    )
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(11, 3.3), layout="constrained")
        grid = figure.subplots(1, len(panels), sharex=True)
        for axes, (column, label) in zip(grid, panels, strict=True):
            for colour, (arm, folders) in zip(COLOURS, runs.items(), strict=False):
                for number, folder in enumerate(folders):
                    series = read_metrics(folder / "metrics.csv").get(column)
                    if series is not None:
                        name = arm if number == 0 else None
                        axes.plot(*series, color=colour, linewidth=1.2, alpha=0.8, label=name)
            axes.set(xlabel="env frames (decisions of all fish)", ylabel=label)
            tidy(axes)
        grid[0].legend(fontsize=8, frameon=False)
        figure.savefig(path)


def write_paths(path: Path, recorded: Recorded, *, task: Any) -> None:
    """Draw the noses' paths, a row per fish, a panel per flow; a cross where an episode ended."""
    speeds = task.stream.speeds_bl
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(11, 0.5 + 2.1 * len(recorded)), layout="constrained")
        grid = figure.subplots(len(recorded), len(speeds), sharex=True, sharey=True, squeeze=False)
        for row, (name, flows) in zip(grid, recorded.items(), strict=True):
            for axes, histories, speed in zip(row, flows, speeds, strict=True):
                _draw_arena(axes, task)
                for number in range(min(_MOST_PATHS, len(histories.flow))):
                    place = histories.place[number].numpy()
                    place = place[~np.isnan(place[:, 0])]
                    axes.plot(*place.T, color=COLOURS[0], linewidth=0.6, alpha=0.45)
                    if histories.terminated[number]:
                        axes.plot(*place[-1], "x", color=COLOURS[1], markersize=5)
                axes.set_title(f"{name}, {speed:g} L/T", fontsize=9)
            row[0].set_ylabel("y  [L]")
        for axes in grid[-1]:
            axes.set_xlabel("x behind the disc  [L]")
        figure.savefig(path)


def write_places(path: Path, recorded: Recorded, *, task: Any) -> None:
    """Draw how often the nose was where, all episodes together, as density per L^2."""
    speeds, area = task.stream.speeds_bl, task.safe_area
    edges = (
        np.linspace(0.0, area.far_bl + 0.2, 43),
        np.linspace(-area.aside_bl, area.aside_bl, 31),
    )
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(11, 0.5 + 2.1 * len(recorded)), layout="constrained")
        grid = figure.subplots(len(recorded), len(speeds), sharex=True, sharey=True, squeeze=False)
        for row, (name, flows) in zip(grid, recorded.items(), strict=True):
            for axes, histories, speed in zip(row, flows, speeds, strict=True):
                place = histories.place.reshape(-1, 2).numpy()
                place = place[~np.isnan(place[:, 0])]
                density, *_ = np.histogram2d(place[:, 0], place[:, 1], bins=edges, density=True)
                mesh = axes.pcolormesh(*edges, density.T, cmap="magma_r", vmin=0.0)
                _draw_arena(axes, task)
                axes.set_title(f"{name}, {speed:g} L/T", fontsize=9)
                figure.colorbar(mesh, ax=axes, label="[1/L²]", pad=0.01)
            row[0].set_ylabel("y  [L]")
        for axes in grid[-1]:
            axes.set_xlabel("x behind the disc  [L]")
        figure.savefig(path)


def write_decisions(
    path: Path, flows: Sequence[Histories], *, task: Any, shedding: Sequence[float]
) -> None:
    """Draw frequency and angle of attack in time, of the first episodes in each flow."""
    speeds = task.stream.speeds_bl
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(11, 5.2), layout="constrained")
        grid = figure.subplots(2, len(speeds), sharex=True, sharey="row", squeeze=False)
        for upper, lower, histories, speed, shed in zip(
            *grid, flows, speeds, shedding, strict=True
        ):
            for number, colour in zip(range(min(3, len(histories.flow))), COLOURS, strict=False):
                times = task.interval_T * np.arange(histories.frequency.shape[1])
                upper.step(
                    times, histories.frequency[number].numpy(), where="post",
                    color=colour, linewidth=1.0,
                )  # fmt: skip
                lower.plot(
                    times + task.interval_T, histories.angle_of_attack[number].numpy() * 180.0 / pi,
                    color=colour, linewidth=1.0,
                )  # fmt: skip
            upper.axhline(shed, color="#777777", linestyle=":", label="shedding frequency")
            upper.set_title(f"stream {speed:g} L/T")
            lower.set_xlabel("time  [T]")
            for axes in (upper, lower):
                tidy(axes)
        grid[0][0].set_ylabel("tail beats per T")
        grid[0][0].legend(fontsize=8, frameon=False)
        grid[1][0].set_ylabel("angle of attack  [°]")
        figure.savefig(path)


def write_work(
    path: Path,
    in_wake: Sequence[Mapping[str, Sequence[float]]],
    free: Sequence[Mapping[str, Sequence[float]]] | None,
    *,
    speeds: Sequence[float],
) -> None:
    """Draw the work done since the start, in each flow; see ``diagnostics.trace_work``."""
    names = (("work", "all forces"), ("lateral_work", "lateral, the paper's form"))
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(11, 3.4), layout="constrained")
        grid = figure.subplots(1, len(speeds), sharey=True, squeeze=False)[0]
        for at, (axes, speed) in enumerate(zip(grid, speeds, strict=True)):
            for where, traces, style in (("wake", in_wake, "-"), ("free stream", free, "--")):
                if traces is None:
                    continue
                for (field, label), colour in zip(names, COLOURS, strict=False):
                    axes.plot(
                        traces[at]["time_T"],
                        traces[at][field],
                        style,
                        color=colour,
                        linewidth=1.4,
                        label=f"{where}: {label}",
                    )
            axes.set(title=f"stream {speed:g} L/T", xlabel="time  [T]", yscale="symlog")
            tidy(axes)
        grid[0].set_ylabel("work  [ρL²(L/T)²]")
        grid[0].legend(fontsize=8, frameon=False)
        figure.savefig(path)


def write_lean(
    path: Path, leans: Sequence[tuple[Tensor, Tensor]], *, speeds: Sequence[float]
) -> None:
    """Draw how far fish lean against their beats, per time and per length of stream.

    Args:
        path: of the PNG.
        leans: of each flow, see ``diagnostics.measure_lean``.
        speeds: of the flows, L / T.
    """
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(9, 3.6), layout="constrained")
        grid = figure.subplots(1, 2, sharey=True)
        for (rates, lean), speed, colour in zip(leans, speeds, COLOURS, strict=False):
            for axes, at in zip(grid, (rates.numpy(), rates.numpy() / speed), strict=True):
                axes.plot(at, lean.numpy(), ".", color=colour, markersize=2, alpha=0.25)
                bins = np.round(at / _LEAN_BIN)
                wanted = [value for value in np.unique(bins) if (bins == value).sum() >= _LEAST]
                middle = [lean.numpy()[bins == value].mean() for value in wanted]
                axes.plot(
                    _LEAN_BIN * np.array(wanted), middle, "o-", color=colour, markersize=4,
                    linewidth=1.4, label=f"stream {speed:g} L/T",
                )  # fmt: skip
        for axes, label in zip(
            grid, ("tail beats  [1/T]", "tail beats  [1/L of stream]"), strict=True
        ):
            axes.set(xlabel=label, ylim=(0.0, None))
            tidy(axes)
        grid[0].set_ylabel("lean, mean of 8 T  [°]")
        grid[0].legend(fontsize=8, frameon=False)
        figure.savefig(path)


def _draw_arena(axes: Axes, task: Any) -> None:
    """Draw half disc and safe area."""
    area, radius = task.safe_area, 0.5 * task.stream.diameter_bl
    corner = (area.near_bl, -area.aside_bl)
    size = (area.far_bl - area.near_bl, 2.0 * area.aside_bl)
    axes.add_patch(
        Rectangle(corner, *size, fill=False, edgecolor="#999999", linestyle="--", linewidth=0.8)
    )
    if task.stream.has_disc:
        axes.add_patch(Wedge((0.0, 0.0), radius, 90.0, 270.0, color="#444444"))
    axes.set(xlim=(-0.3, area.far_bl + 0.2), ylim=(-area.aside_bl - 0.15, area.aside_bl + 0.15))
    axes.set_aspect("equal")
