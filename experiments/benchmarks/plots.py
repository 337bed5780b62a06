"""Figures: bandwidth beside the memory's own, speed against size, parts of a step."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.benchmarks.entry import FISH, KERNEL, PERIODIC, WALLS
from experiments.benchmarks.results import Results, Row
from experiments.figures import COLOURS, STYLE
from experiments.validation.convergence import tidy

SCOPES = {KERNEL: COLOURS[4], PERIODIC: COLOURS[0], WALLS: COLOURS[2], FISH: COLOURS[1]}
LIGHT = "#bbbbbb"


def write_plots(results: Results, folder: Path) -> list[Path]:
    """Draw what there is to draw as PNGs, and return the files.

    Args:
        results: of a run; groups that were not run have no figure.
        folder: is made if it is not there.
    """
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    with mpl.rc_context(STYLE):
        for name, draw in (
            ("roofline", draw_roofline),
            ("scaling", draw_scaling),
            ("profile", draw_profile),
        ):
            figure = draw(results)
            if figure is not None:
                written.append(folder / f"{name}.png")
                figure.savefig(written[-1])
    return written


def draw_roofline(results: Results) -> Figure | None:
    """Draw the bandwidth that each step achieves beside what the memory can do."""
    rows = [
        row
        for group in ("solver", "coupled", "peers", "gpu")
        for row in results.of_group(group)
        if row.scope in SCOPES and not row.label.startswith("solve/")
    ]
    if not rows:
        return None
    rows.sort(key=lambda row: row.bandwidth.median)
    figure = Figure(figsize=(9.0, 1.6 + 0.27 * len(rows)), layout="constrained")
    axes = figure.subplots()
    for i, row in enumerate(rows):
        low, median, high = row.bandwidth
        is_ours = row.code == "fishrl"
        axes.barh(
            i, median, color=SCOPES[row.scope], alpha=1.0 if is_ours else 0.45, height=0.72,
            xerr=[[median - low], [high - median]], error_kw={"elinewidth": 1.0, "capsize": 2},
        )  # fmt: skip
        axes.text(high, i, f"  {median:.{0 if median >= 10.0 else 1}f}", va="center", fontsize=8)
    axes.set_yticks(range(len(rows)), [f"{row.code}: {row.name}" for row in rows], fontsize=8)
    for tick, row in zip(axes.get_yticklabels(), rows, strict=True):
        tick.set_fontweight("bold" if row.code == "fishrl" else "normal")
    _draw_probes(axes, results)
    axes.set(xlabel="GB/s at 72 bytes per node update", ylim=(-0.6, len(rows) - 0.4))
    axes.margins(x=0.08)
    handles = [mpl.patches.Patch(color=colour, label=name) for name, colour in SCOPES.items()]
    axes.legend(
        handles=handles, loc="lower right", fontsize=8, title="strong: fishrl", frameon=True,
        framealpha=1.0, edgecolor="none",
    )  # fmt: skip
    axes.set_title("Bandwidth achieved, and what the memory does", loc="left", pad=18)
    tidy(axes)
    axes.grid(axis="y", visible=False)
    return figure


def _draw_probes(axes: Axes, results: Results) -> None:
    for name, style in (("copy", "--"), ("in place", ":")):
        probe = results.find(f"probe/{name}")
        if probe is not None:
            speed = probe.bandwidth.median
            axes.axvline(speed, color="#222222", linestyle=style, linewidth=1.0)
            axes.annotate(
                f"{name} {speed:.0f}", (speed, 1.0), (0, 2), fontsize=8, ha="center",
                xycoords=("data", "axes fraction"), textcoords="offset points",
            )  # fmt: skip


def draw_scaling(results: Results) -> Figure | None:
    """Draw speed against the size of the grid and against the number of flows."""
    rows = results.of_group("scaling")
    if not rows:
        return None
    figure = Figure(figsize=(9.0, 3.8), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    grid = [row for row in rows if row.label.startswith("grid/")]
    batch = [row for row in rows if row.label.startswith("batch/")]
    _draw_line(left, [row.num_nodes for row in grid], grid, COLOURS[1])
    _draw_line(right, [row.facts["flows"] for row in batch], batch, COLOURS[0])
    for row in grid:
        left.annotate(
            f"L = {row.facts['body_length']}", (row.num_nodes, row.mlups.median), (4, -12),
            textcoords="offset points", fontsize=8,
        )  # fmt: skip
    sizes = results.machine.get("caches", {})
    for name, size in sizes.items():
        nodes = size / 36
        if grid and 0.5 * grid[0].num_nodes < nodes < 2.0 * grid[-1].num_nodes:
            left.axvline(nodes, color=LIGHT, linewidth=1.0)
            left.annotate(
                f"{name} {size / 2**20:g} MB", (nodes, 0.02), (3, 0), fontsize=8, rotation=90,
                xycoords=("data", "axes fraction"), textcoords="offset points",
            )  # fmt: skip
    for axes in (left, right):
        axes.set_xscale("log", base=10 if axes is left else 2)
        tidy(axes)
    if batch:
        counts = [row.facts["flows"] for row in batch]
        right.set_xticks(counts, [str(count) for count in counts])
        length = batch[0].facts["body_length"]
        right.set_title(f"batches of L = {length}, one core each", loc="left")
    left.set_ylim(bottom=0.0)
    left.set(xlabel="nodes", ylabel="MLUPS")
    left.set_title("one flow", loc="left")
    right.set_xlabel("flows")
    figure.suptitle("Whole step with a swimming fish in each flow")
    return figure


def _draw_line(axes: Axes, x: Sequence[float], rows: Sequence[Row], colour: str) -> None:
    low, median, high = ([row.mlups[i] for row in rows] for i in range(3))
    axes.fill_between(x, low, high, color=colour, alpha=0.2, linewidth=0)
    axes.plot(x, median, "o-", color=colour)


def draw_profile(results: Results) -> Figure | None:
    """Draw the parts of an environment step, and once more those beside the flow."""
    study = results.studies.get("profile")
    if study is None:
        return None
    figure = Figure(figsize=(9.0, 4.4), layout="constrained")
    whole, rest = figure.subplots(2, 1)
    flow, others = (
        [row for row in study["rows"] if (row["where"] == "flow") == is_flow]
        for is_flow in (True, False)
    )
    beside = sum(row["seconds"] for row in others)
    total = beside + sum(row["seconds"] for row in flow)
    _stack(whole, [*flow, {"part": "beside the flow", "seconds": beside}])
    _stack(rest, others)
    whole.set_title(
        f"One environment step, {study['num_envs']} × {study['size']}, {study['substeps']} steps "
        f"of the flow on one core: {1e3 * total:.0f} ms",
        loc="left",
    )
    rest.set_title(
        f"Thereof beside the flow: {1e3 * beside:.1f} ms, {100 * beside / total:.2f} %", loc="left"
    )
    return figure


def _stack(axes: Axes, parts: Sequence[dict[str, Any]]) -> None:
    """Draw one bar of parts, with their names and shares in a legend below."""
    total, start = sum(part["seconds"] for part in parts), 0.0
    for part, colour in zip(parts, cycle(COLOURS), strict=False):
        width = 1e3 * part["seconds"]
        share = 100 * part["seconds"] / total
        axes.barh(0, width, left=start, color=colour, label=f"{part['part']}, {share:.1f} %")
        if share > 5.0:
            axes.text(
                start + 0.5 * width, 0, f"{share:.0f} %", ha="center", va="center",
                color="white", fontsize=9,
            )  # fmt: skip
        start += width
    axes.set(yticks=[], ylim=(-0.45, 0.45), xlim=(0.0, start))
    axes.xaxis.set_major_formatter("{x:g} ms")
    axes.legend(
        loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=3, fontsize=8, columnspacing=1.2
    )
    axes.spines[["top", "right", "left"]].set_visible(False)
