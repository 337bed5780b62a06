"""The messages quoted on the troubleshooting page exist in the code."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

from tests.docs.pages import DOCS

ROOT = DOCS.parent
QUOTE = re.compile(r"^```text\n(.*?)\n```$", re.MULTILINE | re.DOTALL)


def _read_literals(path: Path) -> str:
    """Return all strings of a file, one per line, with ``…`` for inserted values."""
    lines = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.JoinedStr):
            pieces = [p.value if isinstance(p, ast.Constant) else "…" for p in node.values]
            lines.append("".join(str(piece) for piece in pieces))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            lines.append(re.sub(r"%(s|d)", "…", node.value))
    return "\n".join(lines)


@cache
def _read_sources() -> list[str]:
    folders = (ROOT / name for name in ("fishrl", "experiments"))
    return [_read_literals(path) for folder in folders for path in folder.rglob("*.py")]


QUOTES = QUOTE.findall((DOCS / "troubleshooting.md").read_text(encoding="utf-8"))


def _list_fragments(quote: str) -> list[str]:
    return [part for part in re.split("…|\n", quote) if len(part.strip()) > 3]


@pytest.mark.parametrize("quote", QUOTES)
def test_quoted_message_exists_in_code(quote: str) -> None:
    fragments = _list_fragments(quote)
    assert fragments
    wrong = [f for f in fragments if not any(f in source for source in _read_sources())]
    assert not wrong, f"nothing in the code says {wrong}"
    assert any(all(f in source for f in fragments) for source in _read_sources())
