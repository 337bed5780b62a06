"""Descriptions of arguments, read from docstrings for ``--help`` and the reference."""

from __future__ import annotations

import inspect
import re


def read_arguments(kind: type) -> dict[str, str]:
    """Return the entries of ``Args:`` of a class and of its bases, by argument."""
    texts: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        texts |= _parse(inspect.cleandoc(base.__doc__ or ""))
    return texts


def _parse(doc: str) -> dict[str, str]:
    match = re.search(r"^Args:\n((?:(?: .*)?\n?)*)", doc, re.MULTILINE)
    texts: dict[str, str] = {}
    name = ""
    for line in match.group(1).splitlines() if match else ():
        begins = re.match(r" {4}(\w+): (.*)", line)
        if begins:
            name = begins.group(1)
            texts[name] = begins.group(2)
        elif name and line.strip():
            texts[name] += " " + line.strip()
    return texts
