"""Blocks of code of README and pages, as printed and as reduced for tests."""

import re
from pathlib import Path
from typing import NamedTuple

DOCS = Path(__file__).parents[2] / "docs"
#: README and all pages but the one that ``make docs`` generates.
PAGES = [
    *(DOCS.parent / name for name in ("README.md", "CONTRIBUTING.md")),
    *(
        page
        for page in sorted(DOCS.rglob("*.md"))
        if page.stem not in ("configuration", "task_reference")
    ),
]
FENCE = re.compile(r"^```(python|yaml)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
FILE = re.compile(r"<!-- file: (\S+) -->")
SMALLER = re.compile(r'<!-- tests: "(.*)" -> "(.*)" -->')
ALWAYS = re.compile(r'<!-- all tests: "(.*)" -> "(.*)" -->')


class Block(NamedTuple):
    """One block of code.

    Attributes:
        language: python or yaml.
        code: as the reader sees it.
        small: as the tests run it, after ``<!-- tests: "this" -> "that" -->`` above the block, or
            ``all tests`` anywhere.
        file: name to store it under, from ``<!-- file: name -->``, if any.
    """

    language: str
    code: str
    small: str
    file: str | None


def read_blocks(page: str) -> list[Block]:
    """Return the blocks of a page of ``docs`` in order."""
    text = (DOCS / page).read_text(encoding="utf-8")
    blocks, end = [], 0
    for match in FENCE.finditer(text):
        before = text[end : match.start()]
        language, code = match.groups()
        small = code
        for old, new in SMALLER.findall(before):
            assert old in small, f"{page}: {old!r} is in no code after this comment"
            small = small.replace(old, new)
        for old, new in ALWAYS.findall(text):
            small = small.replace(old, new)
        named = FILE.search(before)
        blocks.append(Block(language, code, small, named.group(1) if named else None))
        end = match.end()
    assert not SMALLER.search(text[end:]), f"{page}: a comment for tests has no code after it"
    return blocks


def list_pages() -> list[str]:
    """Return the pages with Python blocks."""
    names = [page.relative_to(DOCS).as_posix() for page in sorted(DOCS.rglob("*.md"))]
    return [name for name in names if any(b.language == "python" for b in read_blocks(name))]


def count_lines(code: str) -> int:
    """Return the number of lines that are neither empty nor a comment."""
    lines = [line.strip() for line in code.splitlines()]
    return sum(bool(line) and not line.startswith("#") for line in lines)
