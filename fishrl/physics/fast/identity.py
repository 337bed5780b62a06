"""What determines the code of a function: plain values, and the sources of foreign classes."""

import re
import sys
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache
from pathlib import Path
from types import FunctionType, ModuleType
from uuid import uuid4

import torch

from fishrl.physics.bodies.outline import BodyConfig
from fishrl.physics.cache_key import make_key, read_code

_OWN = "fishrl.physics"
_PROCESS = uuid4().hex
#: What classes may derive from besides; their versions are in the keys of compiled code.
_LIBRARIES = {*sys.stdlib_module_names, "numpy", "pydantic", "torch", "typing_extensions"}


def identify(thing: object) -> object:
    """Return plain values that, with this package's sources, determine a thing completely.

    A thing consists of plain values, sequences, enums, dataclasses, classes, and functions of this
    package with what they close over. Of a body it is what those of a batch share. Classes of other
    modules are known by the sources of these and of what they import, outside other packages that
    are installed, and by the plain values of these modules that the sources name.

    Raises:
        LookupError: for anything else, and for classes of functions or without a source file.
    """
    if isinstance(thing, BodyConfig):
        return [identify(part) for part in thing.get_structure()]
    if isinstance(thing, list | tuple):
        return [identify(part) for part in thing]
    if thing is None or isinstance(thing, bool | int | float | str | torch.dtype):
        return repr(thing)
    if isinstance(thing, FunctionType) and _lies_in(thing.__module__, _OWN):
        held = [cell.cell_contents for cell in thing.__closure__ or ()]
        known = [thing.__defaults__, *(thing.__kwdefaults__ or {}).items(), *held]
        return [thing.__qualname__, *(identify(part) for part in known)]
    kind = thing if isinstance(thing, type) else type(thing)
    for base in kind.__mro__:
        if "<locals>" in base.__qualname__ and not _lies_in(base.__module__, "fishrl"):
            raise LookupError(f"{base!r} may read variables of the function that made it")
    name = [kind.__qualname__, *(_hash_source(base.__module__) for base in kind.__mro__)]
    if isinstance(thing, type):
        return name
    if isinstance(thing, Enum):
        return [*name, thing.name]
    if is_dataclass(thing):
        return [*name, *((f.name, identify(getattr(thing, f.name))) for f in fields(thing))]
    raise LookupError(f"{thing!r} has a state that cannot be known")


def identify_for_file(thing: object) -> object:
    """Return what ``identify`` does; of a thing that cannot be known, what no other process has."""
    try:
        return identify(thing)
    except LookupError:
        return _PROCESS


def _lies_in(module: str, package: str) -> bool:
    return f"{module}.".startswith(f"{package}.")


def _hash_source(name: str) -> str:
    """Return a module's name, with a hash of what determines its classes if it is foreign."""
    sources = sorted((module, read_code(file)) for module, file in _list_foreign(name))
    named = {word for _, code in sources for word in _list_names(code)}
    values = [
        (module, word, repr(value))
        for module, _ in sources
        for word, value in sorted(vars(sys.modules[module]).items())
        if word in named and _is_plain(value)
    ]
    return f"{name} {make_key(*sources, values)}"


@cache
def _list_names(code: bytes) -> frozenset[str]:
    """List the names and attributes in code as ``read_code`` returns it."""
    return frozenset(re.findall(r"\b(?:id|attr)='(?!__)(\w+)'", code.decode()))


def _is_plain(value: object) -> bool:
    if isinstance(value, list | tuple):
        return all(map(_is_plain, value))
    return value is None or isinstance(value, bool | int | float | str | bytes)


def _list_foreign(name: str) -> Iterator[tuple[str, Path]]:
    """List names and files of a module and of those it imports, without libraries and our own."""
    names, package = [name], name.partition(".")[0]
    for each in names:
        module = sys.modules.get(each)
        file = Path(getattr(module, "__file__", None) or "")
        if _lies_in(each, "fishrl") or _is_library(each, file, package):
            continue
        if module is None or each == "__main__" or not file.is_file():
            raise LookupError(f"module {each!r} has no source file")
        yield each, file
        held = [v if isinstance(v, ModuleType) else v.__class__ for v in vars(module).values()]
        held += [v for v in vars(module).values() if isinstance(v, type | FunctionType)]
        imported = (getattr(v, "__module__", None) or getattr(v, "__name__", "") for v in held)
        names += [n for n in dict.fromkeys(imported) if n in sys.modules and n not in names]


def _is_library(name: str, file: Path, package: str) -> bool:
    """Return whether a module is a library's, or of another installed package than ``package``."""
    top, installed = name.partition(".")[0], {"site-packages", "dist-packages"}
    return top in _LIBRARIES or (top != package and bool(installed & set(file.parts)))
