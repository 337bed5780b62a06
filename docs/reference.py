"""Generate the configuration reference from the classes of settings.

Each class is listed once, with the fields that it declares: type and bounds, default, meaning, and
what a field of a training affects. Inherited fields are listed with the base class.
"""

import inspect
from collections.abc import Callable, Iterator
from enum import Enum
from functools import cache
from importlib import import_module
from pathlib import Path
from textwrap import wrap
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt

from fishrl.__main__ import list_programs
from fishrl.envs import AbstractTask
from fishrl.programs.program import Program, read_arguments, write_value
from fishrl.programs.train_settings import TRAINING
from fishrl.settings import REQUIRED, Role, Settings, list_fields, to_plain
from fishrl.settings.base import Arguments, find_schema
from fishrl.training.algorithms.algorithm import find_algorithms
from fishrl.training.logger import CsvLogger

HEAD = """# Configuration reference

Every setting is an argument of a constructor, set on the command line by `key=value`. A dot selects
an argument of an object:

```sh
fishrl train task=karman_gait task.body_length=64 algorithm.alpha_init=0.5 gamma=0.98
```

An unknown key is reported with the nearest existing one, an invalid value with the allowed range.
`--help` lists the settings of one program. These groups choose an object, or a bundle of settings
(`preset`); `--config-dir <folder>` adds your own, as described in
[A task of your own](tutorials/new_task.md).

| group | choices |
|---|---|
"""
#: Headings, and the packages whose settings are listed there; the first that matches counts.
SECTIONS = {
    "Tasks": ("fishrl.envs",),
    "Skins": ("fishrl.physics.skins",),
    "Algorithms": ("fishrl.training.algorithms",),
    "Training": ("fishrl.training", "fishrl.objectives"),
    "Viewer": ("fishrl.viewer",),
    "Programs": ("fishrl.programs",),
    "Research": ("experiments",),
}
SIGNS = {Gt: ("gt", ">"), Ge: ("ge", "≥"), Lt: ("lt", "<"), Le: ("le", "≤")}


def write_reference(path: Path) -> None:
    """Write the page if it has changed."""
    text = make_reference()
    if not path.is_file() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def make_reference() -> str:
    """Return the page as Markdown."""
    programs = reversed(find_programs().items())  # of one schema the first gives the title
    titles = {main.command_line.schema: name for name, main in programs}

    def rank(kind: type) -> tuple[bool, str, int, str]:
        """Put tasks before their parts, and bases before what derives from them."""
        is_part = not issubclass(kind, AbstractTask)
        return is_part, titles.get(kind, ""), len(kind.__mro__), kind.__name__

    largest = sorted(find_classes(), key=lambda kind: len(list_fields(kind)))  # of one function
    by_name = {f"{kind.__module__}.{kind.__qualname__}": kind for kind in largest}
    classes = sorted(by_name.values(), key=rank)
    groups = TRAINING.list_choices().items()
    rows = [f"| `{name}=` | {', '.join(f'`{c}`' for c in choices)} |" for name, choices in groups]
    parts = [HEAD + "\n".join(rows) + "\n"]
    for heading in SECTIONS:
        of_section = [kind for kind in classes if _find_section(kind) == heading]
        parts.append(f"## {heading}\n")
        parts += [f"### {titles.get(k, k.__name__)}\n\n{describe(k)}" for k in of_section]
    return "\n".join(parts)


@cache
def find_programs() -> dict[str, Program]:
    """Return the programs that take settings, by the command that runs them."""
    names = {f"fishrl {n}": f"fishrl.programs.{n.replace('-', '_')}" for n in list_programs()}
    for path in sorted((Path(__file__).parents[1] / "experiments").glob("*.py")):
        if '__name__ == "__main__"' in path.read_text(encoding="utf-8"):
            names[f"python -m experiments.{path.stem}"] = f"experiments.{path.stem}"
    mains = {name: import_module(module).main for name, module in names.items()}
    return {name: main for name, main in mains.items() if isinstance(main, Program)}


@cache
def find_classes() -> set[type]:
    """Return the classes of settings in programs and in the packages that these import."""
    find_programs()
    find_algorithms()
    import_module("fishrl.training.tensorboard")
    return {*_list_below(Settings), *_list_below(CsvLogger)}


def describe(kind: type) -> str:
    """Return the summary of a class and a table of the fields that it declares."""
    summary = (inspect.getdoc(kind) or "").split("\n\n")[0].replace("\n", " ")
    lines = [f"{_escape(summary)} `{kind.__module__}.{kind.__qualname__}`", ""]
    texts, declared = read_arguments(kind), {*inspect.get_annotations(kind)}
    if not issubclass(kind, Settings):
        declared = {*inspect.signature(kind).parameters}
    own = [entry for entry in list_fields(kind) if entry.name in declared]
    has_roles = any(entry.role is not Role.RESULT for entry in own)
    if own:
        head = ["setting", "type", "default", "meaning", *["affects"] * has_roles]
        lines += [f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
    for name, hint, default, role in own:
        cells = [_code(name), _code(_show_type(hint) + _show_bounds(kind, name))]
        cells += [_code(_show_default(default)), _escape(texts.get(name, ""))]
        lines.append(f"| {' | '.join([*cells, *[role.value] * has_roles])} |")
    bases = [b for b in kind.__bases__ if b in find_classes() and list_fields(b)]
    links = ", ".join(f"[{base.__name__}](#{base.__name__.lower()})" for base in bases)
    return "\n".join([*lines, f"\nAlso the settings of {links}.\n" if links else ""])


def show_signature(kind: type) -> str:
    """Return the constructor's signature without bounds, and objects without their arguments."""
    parts = ["*"]
    for name, hint, default, _ in list_fields(kind):
        is_plain = not isinstance(default, Settings | Enum)
        shown = repr(default) if is_plain else f"{type(default).__name__}(...)"
        value = "" if default is REQUIRED else f" = {shown}"
        parts.append(f"{name}: {_show_type(hint, repr).replace('null', 'None')}{value}")
    return f"({', '.join(parts)})" if len(parts) > 1 else "()"


def _list_below(base: type[Any]) -> Iterator[type[Any]]:
    for kind in base.__subclasses__():
        if kind is not Arguments:  # of functions
            yield kind
            yield from _list_below(kind)


def _find_section(kind: type) -> str:
    return next((name for name, of in SECTIONS.items() if kind.__module__.startswith(of)), "")


def _show_type(hint: Any, show_word: Callable[[Any], str] = str) -> str:
    origin, parts = get_origin(hint), get_args(hint)
    if origin is Literal:
        return " | ".join(map(show_word, parts))
    shown = [_show_type(part, show_word) for part in parts]
    if origin is Annotated:
        return shown[0]
    if origin in (Union, UnionType):
        return " | ".join(shown)
    if hint in (None, type(None), ...):
        return "..." if hint is ... else "null"
    name = getattr(origin or hint, "__name__", str(hint))
    return f"{name}[{', '.join(shown)}]" if parts else name


def _show_bounds(kind: type, name: str) -> str:
    bounds = ""
    for mark in find_schema(kind).__pydantic_fields__[name].metadata:
        if type(mark) in SIGNS:
            attribute, sign = SIGNS[type(mark)]
            value = getattr(mark, attribute)
            bounds += f", {sign} {value if isinstance(value, int) else f'{value:g}'}"
    return bounds


def _show_default(value: Any) -> str:
    if value is REQUIRED:
        return "required"
    plain = to_plain(value)
    return f"{type(value).__name__}(…)" if isinstance(plain, dict) else write_value(plain)


def _code(text: str) -> str:
    """Return the text as code; a long one in several pieces, since cells do not wrap inside."""
    pieces = wrap(text, 30, break_long_words=False, break_on_hyphens=False)
    return " ".join(f"`{piece}`" for piece in pieces).replace("|", "\\|")


def _escape(text: str) -> str:
    """Escape what Markdown would read as HTML or as a cell's end; code keeps its brackets."""
    parts = text.replace("``", "`").replace("|", "\\|").split("`")
    return "`".join(p if i % 2 else p.replace("<", "&lt;") for i, p in enumerate(parts))
