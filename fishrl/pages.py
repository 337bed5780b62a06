"""Tables in Markdown and CSV."""

import csv
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from fishrl.files import staged

#: How a formula of a spreadsheet begins, but for a number with a sign.
_FORMULA = re.compile(r"^(?![+-](\d+\.?\d*(e[+-]?\d+)?|inf)$)\s*[=+\-@＝＋－＠]")
_MARKUP = r"[\\|<]|(?<=\])[(\[]"


def write_table(
    heads: Sequence[str], rows: Iterable[Sequence[object]], *, has_links: bool = False
) -> str:
    """Return a Markdown table, which ends with a newline; ``None`` is an empty cell.

    Cells may be bold or code; HTML appears as it is written, and links too unless it ``has_links``.
    """
    pattern = r"[\\|<]" if has_links else _MARKUP
    cells = [
        ["" if cell is None else escape(str(cell), pattern) for cell in row]
        for row in (heads, *rows)
    ]
    lines = [f"| {' | '.join(row)} |" for row in cells]
    lines.insert(1, "|---" * len(heads) + "|")
    return "\n".join(lines) + "\n"


def write_csv(path: Path, heads: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Write a CSV file; an apostrophe begins words that a spreadsheet would take for a formula."""
    cells = [
        [_FORMULA.sub(r"'\g<0>", cell) if isinstance(cell, str) else cell for cell in row]
        for row in (heads, *rows)
    ]
    with staged(path) as stage, stage.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows(cells)


def escape(text: str, pattern: str = _MARKUP) -> str:
    """Return text for Markdown that is no link, no HTML and no cell of a table."""
    return re.sub(pattern, r"\\\g<0>", text)


def show(text: str) -> str:
    """Return text as one line, with an escape for what cannot be printed or controls a terminal."""
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)
