"""Tables in Markdown and CSV."""

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path

from fishrl.files import staged


def write_table(heads: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a Markdown table, which ends with a newline; ``None`` is an empty cell."""
    cells = [
        ["" if cell is None else str(cell).replace("|", "\\|") for cell in row]
        for row in (heads, *rows)
    ]
    lines = [f"| {' | '.join(row)} |" for row in cells]
    lines.insert(1, "|---" * len(heads) + "|")
    return "\n".join(lines) + "\n"


def write_csv(path: Path, heads: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Write a CSV file."""
    with staged(path) as stage, stage.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([heads, *rows])
