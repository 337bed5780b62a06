"""Wrong files for readers: flipped bits, and trees of values with one of them changed.

``ATTEMPTS=1000 pytest tests/test_files.py tests/training/test_stored_files.py`` tries more of them.
"""

from __future__ import annotations

import os
import random
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import torch
from torch import Tensor

ATTEMPTS = int(os.environ.get("ATTEMPTS", "16"))
SECONDS = 10.0  # the most CPU time that a reader may take; others took a minute

DEEP: Any = []
for _ in range(150):
    DEEP = [DEEP]
#: What stands in place of a value; ``...`` for nothing at all.
ODD: tuple[Any, ...] = (
    *(..., None, True, 0, 1.5, -(10**9), 10**30, float("nan"), float("inf"), "word", "a\nb", ""),
    *([], {}, ["word"], {"word": 1}, [[[1]]], DEEP),
)
_ALIASES = "".join(f"a{n + 1}: &a{n + 1} [{', '.join([f'*a{n}'] * 9)}]\n" for n in range(10))
#: Files that are none of ours, or take a parser long.
TEXTS: tuple[bytes, ...] = (
    *(b"a: &a\n  b: *a\n", b"a0: &a0 [x, x]\n" + _ALIASES.encode(), b"a: " + b"[" * 20_000),
    *(b"a: " + b"{b: " * 300 + b"}" * 300, b"- " * 50_000, b"a: !!python/name:os.system\n"),
    *(b"a: !!timestamp word\n", b"a: 2001-01-01\n", b"a: !!set {b}\n", b"a: " + b"1" * 5000),
    *(b"[a]: 1\n", b"1: 1", b"[" * 100_000, b'{"a": ' + b"1" * 5000 + b"}", b'{"a": .inf}'),
    *(b"[1, 2]", b"word", b"", b"3", b"null", b"{", b"\0", b"\xff"),
)
#: In YAML these are words.
OF_JSON = (b'{"a": 1e999}', b'{"a": NaN}', b'{"a": -Infinity}')
_TENSORS: dict[str, Callable[[Tensor], Any]] = {
    "int8": lambda tensor: tensor.to(torch.int8),
    "float16": lambda tensor: tensor.to(torch.float16),
    "complex": lambda tensor: tensor.to(torch.complex64),
    "a row more": lambda tensor: torch.cat((tensor, tensor)),
    "flat": lambda tensor: tensor.reshape(1, 1, -1),
    "sparse": lambda tensor: tensor.to_sparse(),
    "without data": lambda tensor: tensor.to("meta"),
    "not finite": lambda tensor: tensor.double().log().to(tensor.dtype) * float("inf"),
}


def flip(data: bytes, rng: random.Random) -> Iterator[bytes]:
    """Yield copies of a file with one bit flipped in each, half of them near its end.

    There a file of tensors has its directory.
    """
    for number in range(ATTEMPTS):
        place = rng.randrange(len(data) - 900 if number % 2 and len(data) > 900 else 0, len(data))
        yield data[:place] + bytes([data[place] ^ 1 << rng.randrange(8)]) + data[place + 1 :]


def spoil(tree: Any, rng: random.Random) -> Iterator[tuple[str, Any]]:
    """Yield trees with one value or tensor changed, removed or added, and what was done."""
    paths = list(_walk(tree))
    for _ in range(ATTEMPTS):
        path, odd = rng.choice(paths), rng.choice(ODD)
        what, make = f"{path} = {str(odd)[:40]}", lambda _, odd=odd: odd
        if rng.random() < 0.1:
            what, make = f"{path} with more", lambda at: {**at, "w": 1} if _is_map(at) else [at, at]
        elif rng.random() < 0.7 and isinstance(_get(tree, path), Tensor):
            what, make = rng.choice(list(_TENSORS.items()))
            what = f"{path} {what}"
        if path or odd is not ...:
            yield what, _change(tree, path, make)


def try_all(wrong: Iterable[tuple[str, Any]], read: Callable[[Any], Any]) -> Counter[str]:
    """Read wrong files; return how many were refused and how many read.

    Fails for an error that is no ``ValueError`` of one line, and if a file takes long.
    """
    counts: Counter[str] = Counter()
    for what, content in wrong:
        began, said = time.process_time(), ""
        try:
            read(content)
        except (ValueError, SystemExit) as error:
            said = str(error)
        except Exception as error:
            raise AssertionError(f"{what}: {type(error).__name__}: {error}") from error
        # settings have a line for each, which begins with its name
        assert said.count("\n") == 0 or all(": " in line for line in said.splitlines()), what
        assert time.process_time() - began < SECONDS, what
        counts["refused" if said else "read"] += 1
    return counts


def is_equal(one: Any, other: Any) -> bool:
    """Tell whether two trees hold the same, tensors bit for bit."""
    if isinstance(one, Tensor):
        return torch.equal(one.view(torch.uint8), other.view(torch.uint8))
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(is_equal(one[key], other[key]) for key in one)
    if isinstance(one, list | tuple):
        return len(one) == len(other) and all(map(is_equal, one, other))
    return bool(one == other)


def _is_map(value: Any) -> bool:
    return isinstance(value, dict)


def _walk(tree: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    yield path
    items = tree.items() if _is_map(tree) else enumerate(tree if isinstance(tree, list) else ())
    for name, value in items:
        yield from _walk(value, (*path, name))


def _get(tree: Any, path: tuple[Any, ...]) -> Any:
    for name in path:
        tree = tree[name]
    return tree


def _change(tree: Any, path: tuple[Any, ...], make: Callable[[Any], Any]) -> Any:
    """Return a tree whose value at a path is made of the one there; ``...`` removes it."""
    if not path:
        return make(tree)
    name, *rest = path
    items = dict(tree) if _is_map(tree) else dict(enumerate(tree))
    items[name] = _change(items[name], tuple(rest), make)
    items = {key: value for key, value in items.items() if value is not ...}
    return items if _is_map(tree) else list(items.values())
