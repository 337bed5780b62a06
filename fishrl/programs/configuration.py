"""Command lines: hydra composes YAML files and ``key=value`` to plain data, constructors check it.

The settings of a program are a class, its schema; groups of YAML files (``task``, ``algorithm``,
``preset``, ``logger``, ``experiment``) choose objects and bundles. From weakest to strongest:
defaults of constructors, files of groups in the order of the program, a stored run, the command
line. Stored runs are plain data: nothing in them is resolved, and they add nothing to what is
imported, which are modules of fishrl and those that the command line names, by ``modules=[...]``,
a ``_target_`` or ``--config-dir``.
"""

import argparse
import os
import re
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn, cast

import hydra
from hydra import compose, initialize_config_dir
from hydra.core.config_store import ConfigStore
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override, Quote, QuotedString
from hydra.errors import HydraException, MissingConfigException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from fishrl.presets import GROUPS, find_replacement, list_names, merge, read_file
from fishrl.settings import REQUIRED, TARGET, build, list_fields, to_plain, unknown

CONF = Path(__file__).parent / "conf"

Node = dict[str, Any]


def _store_presets() -> None:
    """Give hydra what ``fishrl.presets`` reads."""
    for group in GROUPS:
        for name in list_names(group):
            task, node = read_file(group, name)
            if task is not None:
                node = {"defaults": [{"override /task": task}, "_self_"], **node}
            package = "_global_" if group == "preset" else None
            ConfigStore.instance().store(name, node, group=group, package=package)


_store_presets()


@dataclass(frozen=True, kw_only=True)
class CommandLine:
    """The settings that a program accepts, as ``key=value`` and ``group=name``."""

    name: str  #: name of the program
    schema: type  #: class of its settings
    #: config groups in the order in which they override each other, and the default choice in each,
    #: ``None`` for nothing; without ``algorithm``, only the task of a ``preset`` is used
    groups: Mapping[str, str | None] = field(default_factory=dict)
    conf: Path | None = None  #: folder of YAML files in addition to fishrl's
    #: given the settings of the command line, returns those of a stored run
    stored: Callable[[Node], Node] | None = None
    positional: str | None = None  #: setting whose value is a word without ``=``

    def __post_init__(self) -> None:
        """Give hydra the groups and defaults; it leaves folders and logs alone."""
        quiet = [{"override hydra/job_logging": "none"}, {"override hydra/hydra_logging": "none"}]
        groups = [{name: choice} for name, choice in self.groups.items()]
        places = {"run": {"dir": "."}, "sweep": {"dir": "${folder}", "subdir": "."}}
        node = self.list_defaults() | {
            "defaults": ["_self_", *groups, *quiet],
            "hydra": {**places, "output_subdir": None},
        }
        ConfigStore.instance().store(name=self.name, node=node)

    def list_defaults(self) -> Node:
        """Return the plain defaults of the schema, ``???`` for what must be given."""
        defaults: Node = {}
        for name, _, default, _ in list_fields(self.schema):
            if default is REQUIRED and name not in self.groups:
                defaults[name] = "???"
            elif isinstance(default, str | int | float | tuple | None):
                defaults[name] = to_plain(default)
        return defaults

    def read(self, arguments: Sequence[str] = ()) -> Any:
        """Return the settings of a command line, an instance of ``schema``.

        Args:
            arguments: ``key=value`` each, and ``--config-dir <folder>`` for your own YAML files,
                ``<folder>/task/<name>.yaml``.

        Raises:
            ValueError: with a line for each mistake.
        """
        node, modules = self.compose(arguments)
        if any(entry.name == "modules" for entry in list_fields(self.schema)):
            node["modules"] = modules
        return build(self.schema, node, modules=modules)

    def compose(self, arguments: Sequence[str] = ()) -> tuple[Node, list[str]]:
        """Compose a command line with YAML files and a stored run; see ``read``.

        Returns:
            Plain nested data, not checked yet, and the modules outside fishrl that may be imported
            for it.
        """
        overrides = self.prepare(arguments)
        with self.use_hydra():
            config = compose(self.name, overrides)
            node = cast(Node, OmegaConf.to_container(config, resolve=True))
        node = {key: value for key, value in node.items() if value != "???"}
        own = node.pop("modules", None) or []
        named = [own] if isinstance(own, str) else [str(module) for module in own]
        for module in named:
            import_module(module)
        config_dir = split_options(arguments).config_dir
        trusted = {*list_modules(node), *_search_modules(config_dir, self.groups)}
        changes = [each.key_or_group for each in parse(overrides) if not each.is_delete()]
        given = {key: _select(node, key) for key in changes}
        if "algorithm" not in self.groups:
            kept = {*self.groups, *(key.split(".")[0] for key in given)}
            node = {key: value for key, value in node.items() if key in kept}
        if self.stored is not None:
            node |= self.stored(given)
            whole: Node = {}  # an object's ``_target_`` together with its arguments
            for key in sorted(given.keys() - {*self.groups, "modules"}):
                nested = given[key]
                for name in reversed(key.split(".")):
                    nested = {name: nested}
                merge(whole, nested)
            merge(node, whole, replaces=True)
        modules = {*named, *(module for module in list_modules(node) if module in trusted)}
        outside = {module for module in modules if module.split(".")[0] != "fishrl"}
        return node, sorted(outside)

    @contextmanager
    def use_hydra(self) -> Iterator[None]:
        """Give hydra the folder of YAML files; turn its errors into one-line ValueErrors."""
        try:
            with initialize_config_dir(str(CONF), version_base="1.3"):
                yield
        except (HydraException, OmegaConfBaseException, YAMLError) as error:
            raise explain(error) from error

    def list_choices(self, arguments: Sequence[str] = ()) -> dict[str, list[str]]:
        """List the choices in each group that has any, with those in ``--config-dir``."""
        with self.use_hydra():
            loader = GlobalHydra.instance().config_loader()
            places = [word for word in self.prepare(arguments) if word.startswith("hydra.")]
            found = {
                group: loader.get_group_options(group, config_name=self.name, overrides=places)
                for group in self.groups
            }
        return {group: choices for group, choices in found.items() if choices}

    def prepare(self, arguments: Sequence[str]) -> list[str]:
        """Write a command line as hydra's overrides, which may name any key."""
        options = split_options(arguments)
        bare = {*self.groups, *self.list_defaults()}
        overrides = [self._as_override(word, bare) for word in options.overrides]
        words = [word.lstrip("+") for word in overrides]
        for key in dict.fromkeys(word.partition("=")[0] for word in words):
            named = [word for word in words if word.partition("=")[0] == key]
            if len(named) > 1:
                more = "; run the program once for each" if key == self.positional else ""
                raise ValueError(f"{', '.join(named)}: must be one{more}")
        folders = [] if self.conf is None else [self.conf]
        if options.config_dir is not None:
            folders.append(Path(options.config_dir).expanduser().resolve())
            if not folders[-1].is_dir():
                raise ValueError(f"--config-dir {options.config_dir}: there is no such folder")
        if folders:
            places = ",".join(quote(f"file://{folder}") for folder in folders)
            overrides.append(f"hydra.searchpath=[{places}]")
        return overrides

    def _as_override(self, word: str, bare: Collection[str]) -> str:
        word = word.lstrip("+")
        key, equals, value = word.partition("=")
        if self.positional is not None and not (equals and re.fullmatch(r"~?[\w.]+", key)):
            return f"{self.positional}={quote(word)}"
        if not (key and equals) and not word.startswith("~"):
            raise ValueError(f"{word!r}: settings are given as key=value, without spaces")
        if key not in self.groups and (key in GROUPS or (CONF / key).is_dir()):
            raise unknown(key, sorted(bare))
        if key in self.groups and (value == "null" or value.startswith(("[", "{"))):
            raise ValueError(f"{word}: must be one name, or left out")
        if equals:
            types = {entry.name: entry.type for entry in list_fields(self.schema)}
            is_text = types.get(key) in (str, str | None)
            word = f"{key}={read_value(value, is_text=is_text)}"
        return word if key in bare or re.match(r"~|hydra[./]|.*[/@]", key) else f"++{word}"


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        raise ValueError(message)


def split_options(arguments: Sequence[str]) -> argparse.Namespace:
    """Split a command line into its options, named as hydra's, and ``overrides``."""
    parser = _Parser(add_help=False, allow_abbrev=False)
    parser.add_argument("overrides", nargs="*")
    parser.add_argument("--config-dir", "-cd")
    parser.add_argument("--cfg", "-c", choices=["job"])
    for long, short in (("--help", "-h"), ("--multirun", "-m")):
        parser.add_argument(long, short, action="store_true")
    return parser.parse_intermixed_args(list(arguments))


def run_hydra(run: Callable[[DictConfig], None], name: str | None, words: Sequence[str]) -> None:
    """Run what hydra composes for a program from the words of ``CommandLine.prepare``."""
    arguments, variables = list(sys.argv), dict(os.environ)
    sys.argv[1:] = words
    os.environ["HYDRA_FULL_ERROR"] = "1"  # let hydra raise its errors
    try:
        hydra.main(version_base="1.3", config_path=str(CONF), config_name=name)(run)()
    finally:
        sys.argv[:] = arguments
        if "HYDRA_FULL_ERROR" not in variables:
            del os.environ["HYDRA_FULL_ERROR"]


def quote(value: str) -> str:
    """Quote a value so that hydra reads it verbatim; a plain path needs no quotes."""
    if re.fullmatch(r"[\w.+-]*/[\w./+-]*", value, re.ASCII):
        return value
    value = re.sub(r"(\\*)\$\{", r"\1\1\\${", value)  # no interpolation
    return QuotedString(value, Quote.single).with_quotes()


def read_value(value: str, *, is_text: bool = False) -> str:
    """Quote a typed value where hydra would read an expression instead of a string.

    Args:
        value: what follows ``key=``; ``~/`` is the home folder.
        is_text: whether the setting is a word, such as a path or name, and never a number.
    """
    if value.startswith("~/"):
        value = str(Path(value).expanduser())
    try:
        (override,) = parse([f"key={value}"])
        if not is_text or override.is_sweep_override() or isinstance(override.value(), str | None):
            return value
    except ValueError:
        if re.fullmatch(r"\[.*\]", value):
            return f"[{','.join(read_value(entry) for entry in value[1:-1].split(','))}]"
    return quote(value)


def parse(overrides: Iterable[str]) -> list[Override]:
    """Parse overrides ``key=value`` as hydra does, without its own settings."""
    lines = [line for line in overrides if not re.match("hydra[./]", line)]
    try:
        return OverridesParser.create().parse_overrides(lines)
    except HydraException as error:
        raise explain(error) from error


def explain(error: Exception) -> ValueError:
    """Turn an error of hydra or omegaconf into one line."""
    if isinstance(error, MissingConfigException) and error.options:
        said = find_replacement(str(error.missing_cfg_file).rpartition("/")[2], error.options)
        return ValueError(f"{said} --config-dir <folder> adds YAML files of yours")
    if isinstance(error.__cause__, OmegaConfBaseException) and "full_key" in str(error.__cause__):
        key = error.__cause__.full_key
        return ValueError(f"there is no {key!r} here; --config-dir <folder> adds YAML files")
    return ValueError(" ".join(str(error).split()).replace("'++", "'"))


def list_modules(node: Any) -> Iterator[str]:
    """List the module of each ``_target_`` in nested plain settings."""
    if isinstance(node, Mapping):
        if TARGET in node:
            yield str(node[TARGET]).rpartition(".")[0]
        node = list(node.values())
    for value in node if isinstance(node, list) else ():
        yield from list_modules(value)


def _search_modules(folder: str | None, groups: Iterable[str]) -> Iterator[str]:
    """List the modules that the user's YAML files name."""
    for group in groups if folder else ():
        for path in Path(str(folder), group).expanduser().rglob("*.yaml"):
            text = path.read_text(encoding="utf-8")
            yield from re.findall(rf"{TARGET}: *['\"]?([\w.]+)\.\w+", text)


def _select(node: Any, key: str) -> Any:
    """Return the value of a dotted key, or None."""
    for name in key.split("."):
        node = node.get(name) if isinstance(node, Mapping) else None
    return node
