"""Cache keys of files on disk: compiled steps, wakes, results of studies.

A key changes with any input: settings (by their ``repr``) or code. Comments, docstrings and layout
of the code do not count.
"""

import ast
import hashlib
import sys
from contextlib import suppress
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from fishrl.files import find_cache, write_whole

_DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef)


@cache
def hash_sources(*names: str) -> str:
    """Return a hash of the code of ``fishrl.physics`` and of packages or modules by dotted name.

    Of a package, every ``.py`` and ``.pt`` (weights) file counts, subpackages included.
    """
    files: dict[str, Path] = {}
    for name in ("fishrl.physics", *names):
        try:
            spec = find_spec(name)
        except ModuleNotFoundError:  # of the package that would hold it
            spec = None
        if spec is None or spec.origin is None:
            raise ValueError(f"no package or module {name!r}: give its dotted name")
        folder = Path(spec.origin).parent
        own = [Path(spec.origin)]
        if spec.submodule_search_locations:
            own = [path for path in folder.rglob("*") if path.suffix in (".py", ".pt")]
        files |= {f"{name}/{path.relative_to(folder)}\0": path for path in sorted(own)}
    return _hash_code(files)


def _hash_code(files: dict[str, Path]) -> str:
    """Return a hash of the code of named files, kept on the disk: stripping all takes 0.4 s."""
    whole, code = hashlib.sha256(sys.version.encode()), hashlib.sha256()
    for name, path in files.items():
        whole.update(name.encode() + path.read_bytes())
    cache = find_cache("sources")
    kept = cache and cache / whole.hexdigest()
    if kept and kept.is_file():
        return kept.read_text()
    for name, path in files.items():
        code.update(name.encode() + read_code(path))
    if kept:
        with suppress(OSError):  # it cannot be written
            kept.parent.mkdir(parents=True, exist_ok=True)
            write_whole(kept, code.hexdigest())
    return code.hexdigest()


def read_code(path: Path) -> bytes:
    """Return the code of a Python file as ``strip_code`` does; any other file whole."""
    content = path.read_bytes()
    return strip_code(content).encode() if path.suffix == ".py" else content


@cache
def strip_code(source: str | bytes) -> str:
    """Return a form of Python code without comments, docstrings and layout."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, _DOCUMENTED) and ast.get_docstring(node, clean=False) is not None:
            del node.body[0]
    return ast.dump(tree)


def make_key(*parts: object) -> str:
    """Return 16 hexadecimal digits that change when the ``repr`` of any part does."""
    return hashlib.sha256("\0".join(map(repr, parts)).encode()).hexdigest()[:16]
