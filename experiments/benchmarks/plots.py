"""Figures: bandwidth beside the memory's own, and speed against size."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.patches import Patch

from experiments.benchmarks.comparison import FISH, KERNEL, PERIODIC, WALLS, Row
from experiments.benchmarks.results import Results, measure_speed
from experiments.figures.style import COLOURS, panels, tidy

SCOPES = {KERNEL: COLOURS[4], PERIODIC: COLOURS[0], WALLS: COLOURS[2], FISH: COLOURS[1]}


def write_plots(results: Results, folder: Path) -> dict[Path, str]:
    """Draw what was measured as PNGs in a folder, and return the files and their captions."""
    folder.mkdir(parents=True, exist_ok=True)
    bandwidth, scaling = folder / "roofline.png", folder / "scaling.png"
    written = {}
    if rows := results.of_group("solver", "coupled", "peers", "gpu"):
        written[bandwidth] = "Bandwidth of each step and of the memory"
        write_bandwidth(rows, results, bandwidth)
    if rows := results.of_group("coupled"):
        written[scaling] = "Speed against grid size and number of flows"
        write_scaling(rows, results.machine["caches"], scaling)
    return written


def measure_bandwidth(row: Row) -> tuple[float, ...]:
    """Return the GB/s that the updates move if each population is read and written once."""
    return tuple(1e-3 * row.bytes_per_update * speed for speed in measure_speed(row))


def write_bandwidth(rows: Sequence[Row], results: Results, path: Path) -> None:
    """Draw the bandwidth that each step achieves beside that of a copy and an in-place pass."""
    rows = sorted(
        (row for row in rows if row.scope in SCOPES), key=lambda r: measure_bandwidth(r)[1]
    )
    with panels(path, size=(9.0, 1.6 + 0.27 * len(rows))) as [[axes]]:
        for i, row in enumerate(rows):
            low, median, high = measure_bandwidth(row)
            axes.barh(
                i, median, color=SCOPES[row.scope], alpha=1.0 if row.code == "fishrl" else 0.45,
                height=0.72, xerr=[[median - low], [high - median]], error_kw={"capsize": 2},
            )  # fmt: skip
            axes.text(high, i, f"  {median:.3g}", va="center", fontsize=8)
        for name, style in (("copy", "--"), ("in place", ":")):
            if probe := results.find(f"probe/{name}"):
                speed = measure_bandwidth(probe)[1]
                axes.axvline(speed, color="#222222", linestyle=style, linewidth=1.0)
                axes.text(speed, len(rows) - 0.35, f"{name} {speed:.0f}", ha="center", fontsize=8)
        axes.set_yticks(range(len(rows)), [f"{row.code}: {row.name}" for row in rows], fontsize=8)
        axes.set(xlabel="GB/s at 72 bytes per node update", ylim=(-0.6, len(rows) - 0.4))
        axes.margins(x=0.08)
        handles = [Patch(color=colour, label=name) for name, colour in SCOPES.items()]
        axes.legend(handles=handles, loc="lower right", fontsize=8, title="strong: fishrl")
        axes.set_title("Bandwidth of each step and of the memory", loc="left", pad=18)
        tidy(axes)
        axes.grid(axis="y", visible=False)


def write_scaling(rows: Sequence[Row], caches: dict[str, int], path: Path) -> None:
    """Draw speed against the size of the grid and against the number of flows."""
    batch = [row for row in rows if row.label.startswith("batch")]
    grid = [row for row in rows if row not in batch and row.label != "single/fish"]
    nodes, flows = [row.num_nodes for row in grid], [row.facts["flows"] for row in batch]
    with panels(path, size=(9.0, 3.8), columns=2, sharey=True) as [[left, right]]:
        _draw_line(left, nodes, grid, COLOURS[1])
        _draw_line(right, flows, batch, COLOURS[0])
        for row in grid:
            place = (row.num_nodes, measure_speed(row).median)
            text = f"L = {row.facts['body_length']}"
            left.annotate(text, place, (4, -12), textcoords="offset points", fontsize=8)
        for name, size in caches.items():
            if 0.5 * nodes[0] < size / 36 < 2.0 * nodes[-1]:  # nodes whose populations it holds
                left.axvline(size / 36, color="#bbbbbb", linewidth=1.0)
                left.text(
                    size / 36, 1.0, f"{name} {size / 2**20:g} MB ", fontsize=8, rotation=90,
                    va="top", transform=left.get_xaxis_transform(),
                )  # fmt: skip
        left.set_xscale("log")
        right.set_xscale("log", base=2)
        right.set_xticks(flows, [str(count) for count in flows])
        left.set(xlabel="nodes", ylabel="MLUPS", ylim=(0.0, None))
        left.set_title("one flow", loc="left")
        length = batch[0].facts["body_length"]
        right.set_xlabel("flows")
        right.set_title(f"batches of L = {length}, one core each", loc="left")
        left.figure.suptitle("Whole step with a swimming fish in each flow")
        tidy(left)
        tidy(right)


def _draw_line(axes: Axes, x: Sequence[float], rows: Sequence[Row], colour: str) -> None:
    low, median, high = zip(*(measure_speed(row) for row in rows), strict=True)
    axes.fill_between(x, low, high, color=colour, alpha=0.2, linewidth=0)
    axes.plot(x, median, "o-", color=colour)
