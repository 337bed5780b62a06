"""Wrong files for readers: a tree of values with one of them changed, and bytes with one bit flipped."""

import random
from collections.abc import Callable, Iterator
from typing import Any

import torch
from torch import Tensor

DEEP: Any = []
for _ in range(150):
    DEEP = [DEEP]
#: What stands in place of a value.
ODD: tuple[Any, ...] = (
    *(None, True, 0, 1.5, -(10**9), 10**30, float("nan"), float("inf"), "word", "a\nb", ""),
    *([], {}, ["word"], {"word": 1}, [[[1]]], DEEP),
)
#: Texts that are no file of ours, and some that take a parser long.
TEXTS: dict[str, str] = {
    "yaml recursive": "a: &a\n  b: *a\n",
    "yaml aliases": "a0: &a0 [x, x]\n"
    + "".join(f"a{n + 1}: &a{n + 1} [{', '.join([f'*a{n}'] * 9)}]\n" for n in range(10)),
    "yaml deep": "a: " + "[" * 20_000,
    "yaml wide": "a: " + "{b: " * 300 + "}" * 300,
    "yaml code": "a: !!python/name:os.system\n",
    "yaml date": "a: !!timestamp word\n",
    "yaml day": "a: 2001-01-01\n",
    "yaml set": "a: !!set {b, c}\n",
    "yaml number": "a: " + "1" * 5000 + "\n",
    "yaml key": "[a]: 1\n",
    "json deep": "[" * 100_000,
    "json number": '{"a": ' + "1" * 5000 + "}",
    "json inf": '{"frames": 1e999}',
    "list": "[1, 2]",
    "word": "word",
    "none": "",
    "number": "3",
    "null": "null",
    "cut": "{",
    "zero": "\0",
}


def walk(tree: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the path of each value in a tree of mappings and lists, the whole first."""
    yield path
    below = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list | tuple) else ()
    for name, value in below:
        yield from walk(value, (*path, name))


def change(tree: Any, path: tuple[Any, ...], make: Callable[[Any], Any]) -> Any:
    """Return a tree whose value at a path is made of the one there; ``...`` removes it."""
    if not path:
        return make(tree)
    name, *rest = path
    items = dict(tree) if isinstance(tree, dict) else dict(enumerate(tree))
    items[name] = change(items[name], tuple(rest), make)
    items = {key: value for key, value in items.items() if value is not ...}
    return items if isinstance(tree, dict) else type(tree)(items.values())


def spoil(tree: Any, rng: random.Random, num: int) -> Iterator[tuple[str, Any]]:
    """Yield ``num`` trees with one value swapped, removed or added, each with what was done."""
    paths = list(walk(tree))
    for _ in range(num):
        path, odd = rng.choice(paths), rng.choice([*ODD, ...])
        if rng.random() < 0.1:
            yield f"{path} gains an entry", change(
                tree, path, lambda v: {**v, "word": 1} if isinstance(v, dict) else [v, v]
            )
        elif path or odd is not ...:
            yield f"{path} = {str(odd)[:30]}", change(tree, path, lambda _, odd=odd: odd)


def spoil_tensors(tree: Any, rng: random.Random, num: int) -> Iterator[tuple[str, Any]]:
    """As ``spoil``, with tensors of other types, shapes and values, too."""
    paths = [p for p in walk(tree)]
    makers: dict[str, Callable[[Tensor], Any]] = {
        "int8": lambda t: t.to(torch.int8),
        "complex": lambda t: t.to(torch.complex64),
        "float16": lambda t: t.to(torch.float16),
        "shape": lambda t: t.reshape(1, -1),
        "cut": lambda t: t.reshape(-1)[:-1],
        "sparse": lambda t: t.to_sparse(),
        "nan": lambda t: _put(t, float("nan")),
        "inf": lambda t: _put(t, -float("inf")),
        "meta": lambda t: t.to("meta"),
    }
    tensors = [p for p in paths if isinstance(_get(tree, p), Tensor)]
    for _ in range(num):
        if rng.random() < 0.4:
            yield next(spoil(tree, rng, 1), ("", ...))
            continue
        path, name = rng.choice(tensors), rng.choice(list(makers))
        if name in ("nan", "inf") and not _get(tree, path).is_floating_point():
            name = "int8"
        yield f"{path} {name}", change(tree, path, makers[name])


def _put(tensor: Tensor, value: float) -> Tensor:
    tensor = tensor.clone()
    tensor.view(-1)[-1] = value
    return tensor


def _get(tree: Any, path: tuple[Any, ...]) -> Any:
    for name in path:
        tree = tree[name]
    return tree


def flip(data: bytes, rng: random.Random, num: int) -> Iterator[bytes]:
    """Yield ``num`` copies of a file with one bit flipped in each."""
    for _ in range(num):
        place = rng.randrange(len(data))
        yield data[:place] + bytes([data[place] ^ 1 << rng.randrange(8)]) + data[place + 1 :]
