"""Write the tables of the studies' pages from their data: ``python studies/tables.py``.

In the README of a study, ``<!-- table: <name> -->`` stands above the table of ``data/<name>.csv``.
The columns "a" and "a ±", or "a", "a low" and "a high", are one column of the table; an empty cell
is a dash. This needs the standard library alone.
"""

import csv
import re
from pathlib import Path

STUDIES = Path(__file__).parent
TABLE = re.compile(r"(<!-- table: (\w+) -->\n)(?:\|.*\n)*")


def read_data(study: str, name: str) -> list[dict[str, str]]:
    """Return the rows of ``<study>/data/<name>.csv`` by the names of their columns."""
    with (STUDIES / study / "data" / f"{name}.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file, strict=True))


def write_table(rows: list[dict[str, str]]) -> str:
    """Return the rows as a Markdown table."""
    heads = [name for name in rows[0] if not name.endswith((" ±", " low", " high"))]
    cells = [[_write_cell(row, name) for name in heads] for row in rows]
    lines = [[cell.replace("|", r"\|") for cell in line] for line in (heads, *cells)]
    lines.insert(1, ["---"] * len(heads))
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _write_cell(row: dict[str, str], name: str) -> str:
    value, error, low = row[name], row.get(f"{name} ±"), row.get(f"{name} low")
    if not value:
        return "–"
    if low:
        return f"{value} [{low}, {row[f'{name} high']}]"
    return f"{value} ± {error}" if error else value


def fill(study: str) -> str:
    """Return the page of a study with the tables of its data."""
    page = (STUDIES / study / "README.md").read_text(encoding="utf-8")
    return TABLE.sub(lambda mark: mark[1] + write_table(read_data(study, mark[2])), page)


if __name__ == "__main__":
    for path in STUDIES.glob("*/README.md"):
        path.write_text(fill(path.parent.name), encoding="utf-8")
