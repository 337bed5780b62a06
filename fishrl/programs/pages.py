"""Tables that programs write."""

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path


def write_table(heads: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a Markdown table, which ends with a newline; ``None`` is an empty cell."""
    cells = [["" if cell is None else str(cell) for cell in row] for row in (heads, *rows)]
    lines = [f"| {' | '.join(row)} |" for row in cells]
    lines.insert(1, "|---" * len(heads) + "|")
    return "\n".join(lines) + "\n"


def write_csv(path: Path, heads: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Write a CSV file."""
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([heads, *rows])
