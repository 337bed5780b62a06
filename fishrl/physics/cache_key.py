"""Cache keys of files on disk: compiled steps, wakes, results of studies.

A key changes with any input: settings (by their ``repr``) or code. Comments, docstrings and layout
of the code do not count.
"""

import ast
import hashlib
from functools import cache
from importlib.util import find_spec
from pathlib import Path

_DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef)


@cache
def hash_sources(*names: str) -> str:
    """Return a hash of the code of ``fishrl.physics`` and of packages or modules by dotted name.

    Of a package, every ``.py`` and ``.pt`` (weights) file counts, subpackages included.
    """
    digest = hashlib.sha256()
    for name in ("fishrl.physics", *names):
        try:
            spec = find_spec(name)
        except ModuleNotFoundError:  # of the package that would hold it
            spec = None
        if spec is None or spec.origin is None:
            raise ValueError(f"no package or module {name!r}: give its dotted name")
        folder = Path(spec.origin).parent
        files = [Path(spec.origin)]
        if spec.submodule_search_locations:
            files = [path for path in folder.rglob("*") if path.suffix in (".py", ".pt")]
        for path in sorted(files):
            digest.update(f"{name}/{path.relative_to(folder)}\0".encode() + read_code(path))
    return digest.hexdigest()


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
