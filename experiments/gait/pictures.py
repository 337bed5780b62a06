"""Figures of the Kármán gait study: survival, paths, positions, decisions, lean and work."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle, Wedge
from torch import Tensor

from experiments.figures.learning_curve import read_metrics
from experiments.figures.style import COLOURS, panels, tidy
from experiments.gait.histories import Histories
from fishrl.envs import KarmanGait

_MOST_PATHS = 40
#: Width of the bins of mean lean, beats, and how many windows a bin holds at least.
_LEAN_BIN, _LEAST = 0.25, 10

#: Of one policy: its episodes in each flow.
Recorded = Mapping[str, Sequence[Histories]]


def write_survival(
    path: Path, arms: Mapping[str, Sequence[Sequence[Histories]]], *, speeds: Sequence[float]
) -> None:
    """Draw survival in each flow: a point per episode, a line per seed at its mean.

    Args:
        path: of the PNG.
        arms: of each arm, per seed, per flow.
        speeds: of the flows, L / T.
    """
    with panels(path, columns=len(speeds), size=(11, 3.6), sharey=True) as grid:
        generator = np.random.default_rng(0)
        for flow, (axes, speed) in enumerate(zip(grid[0], speeds, strict=True)):
            for at, seeds in enumerate(arms.values()):
                colour = COLOURS[at % len(COLOURS)]
                for flows in seeds:
                    values = flows[flow].lengths_T.numpy()
                    spread = at + generator.uniform(-0.28, 0.28, len(values))
                    axes.plot(spread, values, ".", color=colour, markersize=3, alpha=0.35)
                    axes.hlines(np.mean(values), at - 0.36, at + 0.36, color=colour, linewidth=1.8)
            axes.set(title=f"stream {speed:g} L/T", ylim=(0, None))
            axes.set_xticks(range(len(arms)), list(arms), rotation=40, ha="right")
            tidy(axes)
        grid[0, 0].set_ylabel("survival  [T]")
        grid[0, 0].figure.suptitle("point: an episode; line: mean of a seed", fontsize=9)


def write_training(path: Path, runs: Mapping[str, Sequence[Path]]) -> None:
    """Draw survival and return during training: a line per run, a colour per arm.

    Args:
        path: of the PNG.
        runs: folders of each arm's seeds.
    """
    shown = (
        ("train/episode_length", "survival, mean of 32 episodes  [decisions]"),
        ("train/return", "return, mean of 32 episodes"),
        ("train/loss_actor", "actor loss"),
    )
    with panels(path, columns=len(shown), size=(11, 3.3), sharex=True) as grid:
        for axes, (column, label) in zip(grid[0], shown, strict=True):
            for colour, (arm, folders) in zip(COLOURS, runs.items(), strict=False):
                for number, folder in enumerate(folders):
                    series = read_metrics(folder / "metrics.csv").get(column)
                    if series is not None:
                        name = arm if number == 0 else None
                        axes.plot(*series, color=colour, linewidth=1.2, alpha=0.8, label=name)
            axes.set(xlabel="env frames (decisions of all fish)", ylabel=label)
            tidy(axes)
        grid[0, 0].legend(fontsize=8, frameon=False)


@contextmanager
def _arenas(
    path: Path, recorded: Recorded, task: KarmanGait
) -> Iterator[Iterator[tuple[Axes, Histories]]]:
    """Yield a panel for each policy and flow, with its episodes; draw the arena into each."""
    speeds, size = task.stream.speeds_bl, (11, 0.5 + 2.1 * len(recorded))
    shape = {"rows": len(recorded), "columns": len(speeds)}
    with panels(path, size=size, **shape, sharex=True, sharey=True) as grid:
        episodes = [histories for flows in recorded.values() for histories in flows]
        yield zip(grid.flat, episodes, strict=True)
        for row, name in zip(grid, recorded, strict=True):
            for axes, speed in zip(row, speeds, strict=True):
                _draw_arena(axes, task)
                axes.set_title(f"{name}, {speed:g} L/T", fontsize=9)
            row[0].set_ylabel("y  [L]")
        for axes in grid[-1]:
            axes.set_xlabel("x behind the disc  [L]")


def write_paths(path: Path, recorded: Recorded, *, task: KarmanGait) -> None:
    """Draw the noses' paths, a row per policy, a panel per flow; a cross where an episode ended."""
    with _arenas(path, recorded, task) as shown:
        for axes, histories in shown:
            for number in range(min(_MOST_PATHS, len(histories.flow))):
                place = _known(histories.place[number])
                axes.plot(*place.T, color=COLOURS[0], linewidth=0.6, alpha=0.45)
                if histories.terminated[number]:
                    axes.plot(*place[-1], "x", color=COLOURS[1], markersize=5)


def write_places(path: Path, recorded: Recorded, *, task: KarmanGait) -> None:
    """Draw the density of the nose's position per L^2, all episodes together."""
    area = task.safe_area
    edges = (
        np.linspace(0.0, area.far_bl + 0.2, 43),
        np.linspace(-area.aside_bl, area.aside_bl, 31),
    )
    with _arenas(path, recorded, task) as shown:
        for axes, histories in shown:
            place = _known(histories.place.reshape(-1, 2))
            density, *_ = np.histogram2d(place[:, 0], place[:, 1], bins=edges, density=True)
            mesh = axes.pcolormesh(*edges, density.T, cmap="magma_r", vmin=0.0)
            axes.figure.colorbar(mesh, ax=axes, label="[1/L²]", pad=0.01)


def write_decisions(
    path: Path, flows: Sequence[Histories], *, task: KarmanGait, shedding: Sequence[float]
) -> None:
    """Draw frequency and angle of attack in time, of the first episodes in each flow."""
    speeds, num = task.stream.speeds_bl, len(flows)
    with panels(path, rows=2, columns=num, size=(11, 5.2), sharex=True, sharey="row") as grid:
        for (upper, lower), histories, speed, shed in zip(
            grid.T, flows, speeds, shedding, strict=True
        ):
            times = task.interval_T * np.arange(histories.frequency.shape[1])
            angles = histories.angle_of_attack.numpy() * 180.0 / pi
            for frequency, angle, colour in zip(
                histories.frequency.numpy()[:3], angles, COLOURS, strict=False
            ):
                upper.step(times, frequency, where="post", color=colour, linewidth=1.0)
                lower.plot(times + task.interval_T, angle, color=colour, linewidth=1.0)
            upper.axhline(shed, color="#777777", linestyle=":", label="shedding frequency")
            upper.set_title(f"stream {speed:g} L/T")
            lower.set_xlabel("time  [T]")
            tidy(upper)
            tidy(lower)
        grid[0, 0].set_ylabel("tail beats per T")
        grid[0, 0].legend(fontsize=8, frameon=False)
        grid[1, 0].set_ylabel("angle of attack  [°]")


def write_work(
    path: Path,
    in_wake: Sequence[Mapping[str, Sequence[float]]],
    free: Sequence[Mapping[str, Sequence[float]]] | None,
    *,
    speeds: Sequence[float],
) -> None:
    """Draw the work done since the start, in each flow; see ``diagnostics.trace_work``."""
    names = (("work", "all forces"), ("lateral_work", "lateral, the paper's form"))
    with panels(path, columns=len(speeds), size=(11, 3.4), sharey=True) as grid:
        for at, (axes, speed) in enumerate(zip(grid[0], speeds, strict=True)):
            for where, traces, style in (("wake", in_wake, "-"), ("free stream", free, "--")):
                for (field, label), colour in zip(names, COLOURS, strict=False):
                    if traces is not None:
                        axes.plot(
                            traces[at]["time_T"], traces[at][field], style, color=colour,
                            linewidth=1.4, label=f"{where}: {label}",
                        )  # fmt: skip
            axes.set(title=f"stream {speed:g} L/T", xlabel="time  [T]", yscale="symlog")
            tidy(axes)
        grid[0, 0].set_ylabel("work  [ρL²(L/T)²]")
        grid[0, 0].legend(fontsize=8, frameon=False)


def write_lean(
    path: Path, leans: Sequence[tuple[Tensor, Tensor]], *, speeds: Sequence[float]
) -> None:
    """Draw lean against tail beats, per time and per length of stream.

    Args:
        path: of the PNG.
        leans: of each flow, see ``diagnostics.measure_lean``.
        speeds: of the flows, L / T.
    """
    with panels(path, columns=2, size=(9, 3.6), sharey=True) as grid:
        for (rates, lean), speed, colour in zip(leans, speeds, COLOURS, strict=False):
            for axes, at in zip(grid[0], (rates.numpy(), rates.numpy() / speed), strict=True):
                axes.plot(at, lean.numpy(), ".", color=colour, markersize=2, alpha=0.25)
                bins = np.round(at / _LEAN_BIN)
                wanted = [value for value in np.unique(bins) if (bins == value).sum() >= _LEAST]
                middle = [lean.numpy()[bins == value].mean() for value in wanted]
                axes.plot(
                    _LEAN_BIN * np.array(wanted), middle, "o-", color=colour, markersize=4,
                    linewidth=1.4, label=f"stream {speed:g} L/T",
                )  # fmt: skip
        for axes, unit in zip(grid[0], ("[1/T]", "[1/L of stream]"), strict=True):
            axes.set(xlabel=f"tail beats  {unit}", ylim=(0.0, None))
            tidy(axes)
        grid[0, 0].set_ylabel("lean, mean of 8 T  [°]")
        grid[0, 0].legend(fontsize=8, frameon=False)


def _known(place: Tensor) -> Any:
    """Return the positions ``[n, 2]`` until the end of the episode."""
    return place[~place[:, 0].isnan()].numpy()


def _draw_arena(axes: Axes, task: KarmanGait) -> None:
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
