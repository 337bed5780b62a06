"""The figure of a run: speed against size."""

from collections.abc import Sequence
from pathlib import Path

from experiments.benchmarks.measuring import Benchmark, Results
from experiments.benchmarks.report import measure_speed
from fishrl.programs.figures.style import COLOURS, panels


def write_plots(results: Results, folder: Path) -> dict[Path, str]:
    """Write the figure of the results, if any, into a folder; return its file and caption."""
    folder.mkdir(parents=True, exist_ok=True)
    if not (cases := results.of_group("coupled")):
        return {}
    write_scaling(cases, results.machine["caches"], folder / "scaling.png")
    return {folder / "scaling.png": "Speed against grid size and number of flows"}


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
