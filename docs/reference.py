"""Generate the configuration reference from constructors.

It lists the arguments of each task and algorithm and of the objects inside them, the settings of
learning, run and viewer, and those of each program: name, type, default, and the description from
the docstring. What several of them share is listed once.
"""

import inspect
import re
from collections.abc import Iterator, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

from hydra.utils import get_object
from omegaconf import OmegaConf

from fishrl.__main__ import list_programs as list_names
from fishrl.envs import AbstractTask
from fishrl.programs.configuration import CONF
from fishrl.programs.policy_settings import PolicySettings
from fishrl.programs.program import Program, TaskSettings, read_arguments, write_value
from fishrl.programs.train_settings import TRAINING
from fishrl.settings import REQUIRED, list_fields
from fishrl.settings import describe as describe_object
from fishrl.training import LearningSettings, RunSettings
from fishrl.viewer import ViewerSettings

HEAD = """# Configuration reference

Every setting is an argument of a constructor, set on the command line by `key=value`. A dot selects
an argument of an object:

```sh
fishrl train task=karman_gait task.body_length=64 algorithm.alpha_init=0.5 gamma=0.98
```

An unknown key is reported with the nearest existing one, an invalid value with the allowed range.
`python -m experiments.<program> --help` lists the settings of one program. These groups choose an
object, or a bundle of settings (`preset`); `--config-dir <folder>` adds your own, as described in
[A task of your own](tutorials/new_task.md).

{groups}
"""
#: Settings that several programs or objects share, and the heading under which they are listed.
SHARED = {
    AbstractTask: "All tasks",
    LearningSettings: "Learning",
    RunSettings: "Run",
    ViewerSettings: "Viewer",
    PolicySettings: "Programs that run a policy",
    TaskSettings: "Programs that study a task",
}
#: Programs in the order of their use; the others follow by name.
FIRST = [f"fishrl {name}" for name in list_names()]


def write_reference(path: Path) -> None:
    """Write the page if it has changed."""
    text = make_reference()
    if not path.is_file() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def make_reference() -> str:
    """Return the page as Markdown, in the order of a training: task, algorithm, learning, run."""
    groups = TRAINING.list_choices()
    chosen = [f"| `{name}=` | {', '.join(f'`{o}`' for o in groups[name])} |" for name in groups]
    parts = [HEAD.format(groups="\n".join(["| group | choices |", "|---|---|", *chosen]))]
    parts += ["## Task\n", *_describe_shared(AbstractTask, level=3), *_describe_group("task")]
    parts += ["## Algorithm\n", *_describe_group("algorithm")]
    for kind in (LearningSettings, RunSettings, ViewerSettings):
        parts += _describe_shared(kind, level=2)
    parts += ["## Logger\n", *_describe_group("logger"), "## Programs\n"]
    for kind in (PolicySettings, TaskSettings):
        parts += _describe_shared(kind, level=3)
    programs = list_programs()
    for name in sorted(programs, key=_rank):
        own = describe_own(programs[name].command_line.schema)
        parts.append(f"### {name}\n\n{own}")
    return "\n".join(parts)


def _rank(program: str) -> tuple[int, str]:
    return (FIRST.index(program) if program in FIRST else len(FIRST), program)


def _describe_shared(kind: type, *, level: int) -> list[str]:
    return [f"{'#' * level} {SHARED[kind]}\n\n{describe(kind)}"]


def _describe_group(group: str) -> list[str]:
    """Return the objects that a group chooses, then those inside them."""
    chosen = {get_object(name) for name in _find_targets(group, is_outer=True)}
    inside = {name for kind in chosen for name in _walk(describe_object(kind()))}
    targets = [get_object(name) for name in sorted({*_find_targets(group), *inside})]
    targets.sort(key=lambda kind: kind not in chosen)
    return [f"### {kind.__name__}\n\n{describe_own(kind)}" for kind in targets]


def list_programs() -> dict[str, Program]:
    """Return the programs by the command that runs them, those with a task first."""
    names = {f"fishrl {name}": f"fishrl.programs.{name.replace('-', '_')}" for name in list_names()}
    for path in sorted((Path(__file__).parents[1] / "experiments").glob("*.py")):
        if '__name__ == "__main__"' in path.read_text(encoding="utf-8"):
            names[f"python -m experiments.{path.stem}"] = f"experiments.{path.stem}"
    mains = {name: import_module(module).main for name, module in names.items()}
    found = {name: main for name, main in mains.items() if isinstance(main, Program)}
    return dict(sorted(found.items(), key=lambda item: not item[1].command_line.groups))


def describe(kind: type) -> str:
    """Return the summary of a class and a table of its arguments."""
    return _write(kind, _make_rows(kind))


def describe_own(kind: type) -> str:
    """Return the same without the rows of ``SHARED`` bases, to which it refers."""
    rows, shared = _make_rows(kind), []
    for base, heading in SHARED.items():
        if issubclass(kind, base):
            rows = [row for row in rows if row not in _make_rows(base)]
            shared.append(f"[{heading}](#{heading.lower().replace(' ', '-')})")
    table = _write(kind, rows)
    return f"{table}\nAlso the settings of {', '.join(shared)}.\n" if shared else table


def _write(kind: type, rows: list[str]) -> str:
    summary = (inspect.getdoc(kind) or "").split("\n\n")[0].replace("\n", " ")
    where = f"`{kind.__module__}.{kind.__qualname__}`"
    head = ["| argument | type | default | meaning |", "|---|---|---|---|"] if rows else []
    return f"{_escape(summary)} {where}\n\n" + "\n".join([*head, *rows]) + "\n"


def _make_rows(kind: type) -> list[str]:
    texts = read_arguments(kind)
    return [
        f"| `{name}` | {_code(_show_type(hint))} "
        f"| {_code(_show_default(default))} | {_escape(texts.get(name, ''))} |"
        for name, hint, default, _ in list_fields(kind)
    ]


def _find_targets(group: str, *, is_outer: bool = False) -> Iterator[str]:
    for path in sorted((CONF / group).glob("*.yaml")):
        found = list(_walk(OmegaConf.to_container(OmegaConf.load(path))))
        yield from found[:1] if is_outer else found


def _walk(node: Any) -> Iterator[str]:
    if isinstance(node, Mapping):
        if "_target_" in node:
            yield node["_target_"]
        for value in node.values():
            yield from _walk(value)


def _show_type(annotation: Any) -> str:
    text = annotation if isinstance(annotation, str) else inspect.formatannotation(annotation)
    bare = re.sub(r"\bAnnotated\[([^,\[\]]+), (?:[^\[\]]|\[[^\]]*\])*\]", r"\1", text)
    return re.sub(r"\b(?:\w+\.)+(\w+)", r"\1", bare)


def _show_default(default: Any) -> str:
    if default is REQUIRED:
        return "required"
    if default is None or isinstance(default, bool | int | float | str | tuple | list):
        return write_value(default)
    return f"{type(default).__name__}(…)"


def _code(text: str) -> str:
    return f"`{text}`".replace("|", "\\|")


def _escape(text: str) -> str:
    """Escape what Markdown would read as HTML or as a cell's end; code keeps its brackets."""
    parts = text.replace("``", "`").replace("|", "\\|").split("`")
    return "`".join(p if i % 2 else p.replace("<", "&lt;") for i, p in enumerate(parts))
