"""The pages of the docs as programs: their blocks of code, as written and as made small."""

import re
from pathlib import Path
from typing import NamedTuple

DOCS = Path(__file__).parents[2] / "docs"
FENCE = re.compile(r"^```(python|yaml)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
FILE = re.compile(r"<!-- file: (\S+) -->")
SMALLER = re.compile(r'<!-- tests: "(.*)" -> "(.*)" -->')


class Block(NamedTuple):
    """One block of code.

    Attributes:
        language: python or yaml.
        code: as the reader sees it.
        small: as the tests run it: ``<!-- tests: "this" -> "that" -->`` before the block.
        file: the name it is to be stored under, if any: ``<!-- file: name -->``.
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
        named = FILE.search(before)
        blocks.append(Block(language, code, small, named.group(1) if named else None))
        end = match.end()
    assert not SMALLER.search(text[end:]), f"{page}: a comment for tests has no code after it"
    return blocks


def list_pages() -> list[str]:
    """Return the pages that have Python in them."""
    pages = sorted(DOCS.rglob("*.md"))
    names = [path.relative_to(DOCS).as_posix() for path in pages]
    return [name for name in names if any(b.language == "python" for b in read_blocks(name))]


def count_lines(code: str) -> int:
    """Return how many lines say something: neither empty nor a comment alone."""
    lines = [line.strip() for line in code.splitlines()]
    return sum(bool(line) and not line.startswith("#") for line in lines)
