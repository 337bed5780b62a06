"""Figures of the Kármán gait."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.patches import Rectangle, Wedge

from experiments.gait.trials import Histories
from fishrl.envs import KarmanGait
from fishrl.programs.figures.style import COLOURS, panels
from fishrl.viewer.film import label_axes

_MOST_PATHS = 40

#: The episodes of one policy in each flow.
Recorded = Mapping[str, Sequence[Histories]]
#: Work in each flow, see ``diagnostics.trace_work``.
Traces = Sequence[Mapping[str, Sequence[float]]]


@contextmanager
def _flow_panels(
    path: Path, speeds: Sequence[float], *, height: float, **options: Any
) -> Iterator[Any]:
    """Yield a grid with a column per flow, named by the speed of its stream in L / T."""
    options = {"sharey": True, **options}
    with panels(path, columns=len(speeds), size=(11, height), **options) as grid:
        yield grid
        for axes, speed in zip(grid[0], speeds, strict=True):
            axes.set_title(f"stream {speed:g} L/T")


def write_survival(
    path: Path, arms: Mapping[str, Sequence[Sequence[Histories]]], *, speeds: Sequence[float]
) -> None:
    """Draw survival of each arm, per seed, per flow: a point per episode, a line per seed."""
    generator = np.random.default_rng(0)
    with _flow_panels(path, speeds, height=3.6) as grid:
        for flow, axes in enumerate(grid[0]):
            for at, seeds in enumerate(arms.values()):
                colour = COLOURS[at % len(COLOURS)]
                for flows in seeds:
                    values = flows[flow].lengths_T.numpy()
                    spread = at + generator.uniform(-0.28, 0.28, len(values))
                    axes.plot(spread, values, ".", color=colour, markersize=3, alpha=0.35)
                    axes.hlines(np.mean(values), at - 0.36, at + 0.36, color=colour, linewidth=1.8)
            axes.set_ylim(0, None)
            axes.set_xticks(range(len(arms)), list(arms), rotation=40, ha="right")
        grid[0, 0].set_ylabel("survival  [T]")
        grid[0, 0].figure.suptitle("point: an episode; line: mean of a seed", fontsize=9)


def write_paths(path: Path, recorded: Recorded, *, task: KarmanGait) -> None:
    """Draw the noses' paths, a row per policy, a panel per flow; a cross where an episode ended."""
    area, radius = task.safe_area, 0.5 * task.stream.diameters_bl[0]  # 0 without a disc
    corner, height = (area.near_bl, -area.aside_bl), area.aside_bl + 0.15
    extent = (area.far_bl - area.near_bl, 2.0 * area.aside_bl)
    border: Any = {"edgecolor": "#999999", "linestyle": "--", "linewidth": 0.8}
    shape: Any = {"rows": len(recorded), "columns": len(task.stream.speeds_bl), "has_grid": False}
    size = (11, 0.5 + 2.1 * len(recorded))
    with panels(path, size=size, **shape, sharex=True, sharey=True) as grid:
        for row, (name, flows) in zip(grid, recorded.items(), strict=True):
            for axes, histories, label in zip(row, flows, task.stream.labels, strict=True):
                axes.add_patch(Rectangle(corner, *extent, fill=False, **border))
                axes.add_patch(Wedge((0.0, 0.0), radius, 90.0, 270.0, color="#444444"))
                for place, has_ended in zip(
                    histories.place[:_MOST_PATHS], histories.terminated, strict=False
                ):
                    known = place[~place[:, 0].isnan()].numpy()
                    axes.plot(*known.T, color=COLOURS[0], linewidth=0.6, alpha=0.45)
                    if has_ended:
                        axes.plot(*known[-1], "x", color=COLOURS[1], markersize=5)
                axes.set(xlim=(-0.3, area.far_bl + 0.2), ylim=(-height, height), aspect="equal")
                axes.set_title(f"{name}, {label['name']}", fontsize=9)
                label_axes(axes, x=name == [*recorded][-1], y=axes is row[0])


def write_decisions(
    path: Path, flows: Sequence[Histories], *, task: KarmanGait, shedding: Sequence[float]
) -> None:
    """Draw frequency and angle of attack in time, of the first episodes in each flow."""
    shared: Any = {"sharex": True, "sharey": "row"}
    with _flow_panels(path, task.stream.speeds_bl, height=5.2, rows=2, **shared) as grid:
        for (upper, lower), histories, shed in zip(grid.T, flows, shedding, strict=True):
            times = task.interval_T * np.arange(histories.frequency.shape[1])
            frequencies = histories.frequency.numpy()[:3]
            angles = histories.angle_of_attack.numpy() * 180.0 / pi
            for frequency, angle, colour in zip(frequencies, angles, COLOURS, strict=False):
                upper.step(times, frequency, where="post", color=colour, linewidth=1.0)
                lower.plot(times + task.interval_T, angle, color=colour, linewidth=1.0)
            upper.axhline(shed, color="#777777", linestyle=":", label="shedding frequency")
            lower.set_xlabel("time  [T]")
        grid[0, 0].set_ylabel("tail beats per T")
        grid[0, 0].legend(fontsize=8)
        grid[1, 0].set_ylabel("angle of attack  [°]")


def write_work(
    path: Path, in_wake: Traces, free: Traces | None, *, speeds: Sequence[float]
) -> None:
    """Draw the work of muscles and of the torque that holds the heading since the start."""
    names = {"work": "muscles", "torque_work": "torque", "lateral_work": "lateral, paper's form"}
    with _flow_panels(path, speeds, height=3.4) as grid:
        for at, axes in enumerate(grid[0]):
            for where, traces, style in (("wake", in_wake, "-"), ("free stream", free, "--")):
                for (field, label), colour in zip(names.items(), COLOURS, strict=False):
                    if traces is not None:
                        line = (traces[at]["time_T"], traces[at][field], style)
                        axes.plot(*line, color=colour, linewidth=1.4, label=f"{where}: {label}")
            axes.set(xlabel="time  [T]", yscale="symlog")
        grid[0, 0].set_ylabel("work  [ρL²(L/T)²]")
        grid[0, 0].legend(fontsize=8)
