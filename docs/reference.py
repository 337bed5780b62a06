"""Generate the configuration reference from constructors.

It lists the settings of each program and the arguments of each task, algorithm and logger, and of
the objects inside them: name, type, default, and the description from the docstring.
"""

import inspect
import re
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, fields, is_dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from hydra.utils import get_object
from omegaconf import OmegaConf

from experiments.configuration import CONF
from experiments.program import Program, list_choices, read_arguments

HEAD = """# Configuration reference

Every setting is an argument of a constructor. Set it on the command line by `key=value`; a dot
selects an argument of an object (`task.body_length=64`). An unknown key is reported with the
nearest existing one, an invalid value with the allowed range.

Choices: {groups}. Add your own by `--config-dir <folder>`; see
[A task of your own](tutorials/new_task.md).
"""


def write_reference(path: Path) -> None:
    """Write the page if it has changed."""
    text = make_reference()
    if not path.is_file() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def make_reference() -> str:
    """Return the page as Markdown."""
    groups = list_choices()
    said = "; ".join(f"`{name}=` {', '.join(f'`{o}`' for o in groups[name])}" for name in groups)
    parts = [HEAD.format(groups=said)]
    for name, program in list_programs().items():
        schema = program.command_line.schema
        parts.append(f"## python -m experiments.{name}\n\n{describe(schema)}")
    for group in groups:
        targets = sorted(set(_find_targets(group)))
        if targets:
            parts.append(f"## In {group}\n")
        parts += [
            f"### {target.rsplit('.', 1)[-1]}\n\n{describe(get_object(target))}"
            for target in targets
        ]
    return "\n".join(parts)


def list_programs() -> dict[str, Program]:
    """Return the programs of ``experiments`` by name, those with a task first."""
    found: dict[str, Program] = {}
    for path in sorted(CONF.parent.glob("*.py")):
        if '__name__ == "__main__"' in path.read_text(encoding="utf-8"):
            main = import_module(f"experiments.{path.stem}").main
            if isinstance(main, Program):
                found[path.stem] = main
    return dict(sorted(found.items(), key=lambda item: not item[1].command_line.groups))


def describe(kind: type) -> str:
    """Return the summary of a class and a table of its arguments."""
    summary = (inspect.getdoc(kind) or "").split("\n\n")[0].replace("\n", " ")
    texts = read_arguments(kind)
    rows = ["| argument | type | default | meaning |", "|---|---|---|---|"]
    for name, parameter in inspect.signature(kind).parameters.items():
        type_name = _show_type(parameter.annotation)
        rows.append(
            f"| `{name}` | {_code(type_name)} | {_code(_show_default(kind, parameter))} "
            f"| {_escape(texts.get(name, ''))} |"
        )
    where = f"`{kind.__module__}.{kind.__qualname__}`"
    return f"{_escape(summary)} {where}\n\n" + "\n".join(rows) + "\n"


def _find_targets(group: str) -> Iterator[str]:
    for path in sorted((CONF / group).glob("*.yaml")):
        yield from _walk(OmegaConf.to_container(OmegaConf.load(path)))


def _walk(node: Any) -> Iterator[str]:
    if isinstance(node, Mapping):
        if "_target_" in node:
            yield node["_target_"]
        for value in node.values():
            yield from _walk(value)


def _show_type(annotation: Any) -> str:
    text = annotation if isinstance(annotation, str) else inspect.formatannotation(annotation)
    return re.sub(r"\b(?:\w+\.)+(\w+)", r"\1", text)


def _show_default(kind: type, parameter: inspect.Parameter) -> str:
    default = parameter.default
    if default is inspect.Parameter.empty or default == "???":
        return "required"
    if is_dataclass(kind):
        by_name = {entry.name: entry for entry in fields(kind)}
        if by_name[parameter.name].default_factory is not MISSING:
            default = by_name[parameter.name].default_factory()
    if is_dataclass(default) or not isinstance(default, bool | int | float | str | tuple | list):
        return "none" if default is None else f"{type(default).__name__}(…)"
    return str(list(default)) if isinstance(default, tuple) else str(default)


def _code(text: str) -> str:
    return f"`{text}`".replace("|", "\\|")


def _escape(text: str) -> str:
    return text.replace("``", "`").replace("|", "\\|").replace("<", "&lt;")
