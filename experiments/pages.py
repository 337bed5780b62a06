"""Pages of the documentation whose numbers a command writes: marked places, filled anew."""

from __future__ import annotations

from pathlib import Path


def fill(page: Path, name: str, text: str) -> None:
    """Replace what stands between ``<!-- name: begin -->`` and ``<!-- name: end -->``.

    Raises:
        ValueError: if the page is missing, or its marks are.
    """
    before, after = divide(page, name)
    begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
    page.write_text(f"{before}{begin}\n{text.strip()}\n{end}{after}", encoding="utf-8")


def divide(page: Path, name: str) -> tuple[str, str]:
    """Return what stands before and after a marked place, or say what is missing; see ``fill``."""
    if not page.is_file():
        raise ValueError(f"{page}: no such file; give the folder of the documentation")
    whole = page.read_text(encoding="utf-8")
    begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
    if whole.count(begin) != 1 or whole.count(end) != 1 or whole.index(begin) > whole.index(end):
        raise ValueError(f"{page}: put one line {begin} and below it one line {end} into it")
    before, rest = whole.split(begin)
    return before, rest.split(end)[1]
