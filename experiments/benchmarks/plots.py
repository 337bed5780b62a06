"""Figures: bandwidth relative to that of memory, and speed against size."""

from collections.abc import Sequence
from pathlib import Path

from matplotlib.patches import Patch

from experiments.benchmarks.measuring import FISH, KERNEL, PERIODIC, WALLS, Benchmark, Results
from experiments.benchmarks.report import measure_speed
from fishrl.programs.figures.style import COLOURS, panels

SCOPES = {KERNEL: COLOURS[4], PERIODIC: COLOURS[0], WALLS: COLOURS[2], FISH: COLOURS[1]}


def write_plots(results: Results, folder: Path) -> dict[Path, str]:
    """Write figures of the results into a folder; return their files and captions."""
    folder.mkdir(parents=True, exist_ok=True)
    bandwidth, scaling = folder / "roofline.png", folder / "scaling.png"
    written = {}
    if cases := [case for case in results.cases if case.scope in SCOPES]:
        written[bandwidth] = "Bandwidth of each step and of the memory"
        write_bandwidth(cases, results, bandwidth)
    if cases := results.of_group("coupled"):
        written[scaling] = "Speed against grid size and number of flows"
        write_scaling(cases, results.machine["caches"], scaling)
    return written


def measure_bandwidth(case: Benchmark) -> tuple[float, ...]:
    """Return the bandwidth in GB/s if each population is read and written once."""
    return tuple(1e-3 * case.bytes_per_update * speed for speed in measure_speed(case))


def write_bandwidth(cases: Sequence[Benchmark], results: Results, path: Path) -> None:
    """Draw the bandwidth of each step next to a copy and an in-place pass."""
    cases = sorted(cases, key=lambda case: measure_bandwidth(case)[1])
    with panels(path, size=(9.0, 1.6 + 0.27 * len(cases))) as [[axes]]:
        for i, case in enumerate(cases):
            low, median, high = measure_bandwidth(case)
            axes.barh(
                i, median, color=SCOPES[case.scope], height=0.72,
                xerr=[[median - low], [high - median]], error_kw={"capsize": 2},
            )  # fmt: skip
            axes.text(high, i, f"  {median:.3g}", va="center", fontsize=8)
        for name, style, side in (("copy", "--", "right"), ("in place", ":", "left")):
            if probe := results.find(f"probe/{name}"):
                speed = measure_bandwidth(probe)[1]
                axes.axvline(speed, color="#222222", linestyle=style, linewidth=1.0)
                axes.text(speed, len(cases) - 0.35, f"{name} {speed:.0f}", ha=side, fontsize=8)
        axes.set_yticks(range(len(cases)), [case.name for case in cases], fontsize=8)
        axes.set(xlabel="GB/s at 72 bytes per node update", ylim=(-0.6, len(cases) - 0.4))
        axes.margins(x=0.08)
        handles = [Patch(color=colour, label=name) for name, colour in SCOPES.items()]
        axes.figure.legend(
            handles=handles, fontsize=8, loc="outside lower center", ncols=len(SCOPES)
        )
        axes.grid(axis="y", visible=False)


def write_scaling(cases: Sequence[Benchmark], caches: dict[str, int], path: Path) -> None:
    """Draw speed against the size of the grid and against the number of flows."""
    batch = [case for case in cases if case.label.startswith("batch")]
    grid = [case for case in cases if case not in batch and case.label != "single/fish"]
    nodes, flows = [case.num_nodes for case in grid], [case.facts["flows"] for case in batch]
    with panels(path, size=(9.0, 3.8), columns=2, sharey=True) as [[left, right]]:
        for axes, x, line, colour in (
            (left, nodes, grid, COLOURS[1]),
            (right, flows, batch, COLOURS[0]),
        ):
            low, median, high = zip(*map(measure_speed, line), strict=True)
            axes.fill_between(x, low, high, color=colour, alpha=0.2, linewidth=0)
            axes.plot(x, median, "o-", color=colour)
        for name, size in caches.items():
            if 0.5 * nodes[0] < size / 36 < 2.0 * nodes[-1]:  # nodes whose populations it holds
                left.axvline(size / 36, color="#bbbbbb", linewidth=1.0)
                label = f" {name} {size / 2**20:g} MB"
                left.text(size / 36, 0.0, label, rotation=90, ha="right", va="bottom")
        left.set_xscale("log")
        right.set_xscale("log", base=2)
        right.set_xticks(flows, [str(count) for count in flows])
        lengths = ", ".join(str(case.facts["body_length"]) for case in grid)
        left.set(xlabel=f"nodes: one flow, L = {lengths}", ylabel="MLUPS", ylim=(0.0, None))
        right.set(xlabel=f"flows of L = {batch[0].facts['body_length']}, one core each")
        left.figure.suptitle("Whole step with a swimming fish in each flow")
