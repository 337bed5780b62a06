"""Keys of what is kept on disk: compiled steps, wakes, results of studies.

A key changes when any input does: settings (by their ``repr``) or source code.
"""

import hashlib
from functools import cache
from importlib.util import find_spec
from pathlib import Path


@cache
def hash_sources(*names: str) -> str:
    """Return a hash of the sources of ``fishrl.physics`` and of further packages or modules.

    Args:
        *names: dotted names, such as ``"fishrl.envs"``. Of a package, every ``.py`` and ``.pt``
            (weights) file counts, subpackages included.
    """
    digest = hashlib.sha256()
    for name in ("fishrl.physics", *names):
        spec = find_spec(name)
        if spec is None or spec.origin is None:
            raise ValueError(f"no package or module {name!r}: give its dotted name")
        folder = Path(spec.origin).parent
        files = [Path(spec.origin)]
        if spec.submodule_search_locations:
            files = [path for path in folder.rglob("*") if path.suffix in (".py", ".pt")]
        for path in sorted(files):
            digest.update(f"{name}/{path.relative_to(folder)}\0".encode() + path.read_bytes())
    return digest.hexdigest()


def make_key(*parts: object) -> str:
    """Return 16 hexadecimal digits that change when the ``repr`` of any part does."""
    return hashlib.sha256("\0".join(map(repr, parts)).encode()).hexdigest()[:16]
