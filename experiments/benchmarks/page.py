"""The measured part of docs/performance.md, between two marks; the words around it are written."""

from __future__ import annotations

from pathlib import Path

from experiments.benchmarks.plots import write_plots
from experiments.benchmarks.results import Results
from experiments.benchmarks.tables import describe_run, list_tables, render_markdown
from experiments.pages import divide, fill

NAME = "measured"  # of the marked place
CAPTIONS = {
    "roofline": "Bandwidth of each step beside a copy and an in-place pass over memory",
    "scaling": "Speed against the size of the grid and the number of flows",
    "profile": "Parts of an environment step",
}


def write_page(results: Results, docs: Path) -> list[Path]:
    """Put the tables and figures of a run into the page, and return the files written.

    Args:
        results: of a run.
        docs: folder of ``performance.md`` and ``figures``.

    Raises:
        ValueError: if the page is missing, or its marks are.
    """
    page = docs / "performance.md"
    divide(page, NAME)  # a page that cannot be filled is found before anything is drawn
    figures = write_plots(results, docs / "figures" / "benchmark")
    fill(page, NAME, render(results, figures))
    return [page, *figures]


def render(results: Results, figures: list[Path]) -> str:
    """Return the measured part."""
    parts = [describe_run(results), *(render_markdown(table) for table in list_tables(results))]
    parts += [f"![{CAPTIONS[path.stem]}](figures/benchmark/{path.name})" for path in figures]
    return "\n\n".join(parts)
