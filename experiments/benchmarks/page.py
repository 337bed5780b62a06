"""The measured part of docs/performance.md, between two marks; the words around it are written."""

from __future__ import annotations

from pathlib import Path

from experiments.benchmarks.plots import write_plots
from experiments.benchmarks.results import Results
from experiments.benchmarks.tables import describe_run, list_tables, render_markdown

BEGIN, END = "<!-- measured: begin -->", "<!-- measured: end -->"
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
    if not page.is_file():
        raise ValueError(f"{page}: no such file; give the folder of the documentation")
    text = page.read_text(encoding="utf-8")
    if text.count(BEGIN) != 1 or text.count(END) != 1 or text.index(BEGIN) > text.index(END):
        raise ValueError(f"{page}: put one line {BEGIN} and below it one line {END} into it")
    before, rest = text.split(BEGIN)
    after = rest.split(END)[1]
    figures = write_plots(results, docs / "figures" / "benchmark")
    page.write_text(f"{before}{BEGIN}\n{render(results, figures)}\n{END}{after}", encoding="utf-8")
    return [page, *figures]


def render(results: Results, figures: list[Path]) -> str:
    """Return the measured part."""
    parts = [describe_run(results), *(render_markdown(table) for table in list_tables(results))]
    parts += [f"![{CAPTIONS[path.stem]}](figures/benchmark/{path.name})" for path in figures]
    return "\n\n".join(parts)
