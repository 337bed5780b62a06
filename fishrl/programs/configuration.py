"""Settings of the programs: hydra composes them, constructors are the schema.

A program has a dataclass as its schema and may take groups of YAML files (``task``, ``preset``,
``algorithm``, ``logger``). What a YAML file or the command line sets below a ``_target_`` is
checked against the signature of the class it names; every plain default is filled in. From weakest
to strongest: defaults of constructors, files of a group such as ``task=<name>``, the preset that
was asked for, settings of a stored run, the command line.

A stored run names its classes, but never what is imported: that are modules of fishrl, those in
``modules=[...]``, and those that a ``_target_`` of the command line or of the YAML files names.
Whatever is wrong raises ValueError in one line, with the nearest right word for a typo.
"""

from __future__ import annotations

import argparse
import inspect
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, make_dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn, cast, get_args, get_origin

from hydra import compose, initialize_config_dir
from hydra.core.config_store import ConfigStore
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override, Quote, QuotedString
from hydra.errors import HydraException, MissingConfigException
from omegaconf import MISSING, DictConfig, OmegaConf
from omegaconf.errors import ConfigKeyError, OmegaConfBaseException
from yaml import YAMLError  # type: ignore[import-untyped]

from fishrl.bounds import FITTING, check_bounds, is_huge, suggest
from fishrl.envs import AbstractTask
from fishrl.settings import REQUIRED, TARGET, Settings, find_class, list_fields, to_plain
from fishrl.settings.plain import list_classes
from fishrl.training.algorithms import Algorithm
from fishrl.training.description import make
from fishrl.training.logger import CsvLogger

CONF = Path(__file__).parent / "conf"
#: Name under which hydra finds the defaults list of the program that runs.
PRIMARY = "program"
#: What the groups make.
KINDS: dict[str, type] = {"task": AbstractTask, "algorithm": Algorithm, "logger": CsvLogger}

Values = Mapping[str, Any]


@dataclass(frozen=True, kw_only=True)
class CommandLine:
    """The settings a program accepts, as ``key=value`` and ``group=name``.

    Args:
        schema: dataclass of the settings; its ``__post_init__`` checks their range.
        groups: config groups and the default choice in each, ``None`` for nothing.
        is_training: take every setting of a preset; otherwise only its task.
        stored: given the command line's settings, returns those of a stored run; they override
            the YAML files and are overridden by the command line.
        positional: setting whose value is a word without ``=``.
        others: setting that lists all words but those of the schema.
    """

    schema: type
    groups: Mapping[str, str | None] = field(default_factory=dict)
    is_training: bool = False
    stored: Callable[[Values], Values] | None = None
    positional: str | None = None
    others: str | None = None

    def read(self, arguments: Sequence[str] = ()) -> Any:
        """Return the settings of a command line, an instance of ``schema``."""
        config = self.compose(arguments)
        for name in sorted(OmegaConf.missing_keys(config)):
            raise ValueError(f"{name}: has no default; give {name}=<value>")
        settings = self.schema(**cast(dict[str, Any], OmegaConf.to_container(config)))
        check_bounds(settings)
        for name in self.groups:
            if name in KINDS:
                make(getattr(settings, name), kind=KINDS[name])  # checks what is below it
        return settings

    def compose(self, arguments: Sequence[str] = ()) -> DictConfig:
        """Compose a command line, check keys and types, and fill in the defaults.

        Args:
            arguments: ``key=value`` each, and ``--config-dir <folder>`` for your own YAML
                files, ``<folder>/task/<name>.yaml``.
        """
        overrides = self.prepare(arguments)
        given = parse(overrides)
        for override in given:
            if override.key_or_group in self.groups and isinstance(override.value(), list | dict):
                raise ValueError(f"{override.input_line}: must be one name")
        try:
            with initialize_config_dir(str(CONF), version_base="1.3"):
                config = compose(PRIMARY, overrides)
        except (HydraException, OmegaConfBaseException, YAMLError) as error:
            raise explain(error) from error
        if not self.is_training:
            taken = {override.key_or_group.split(".", 1)[0] for override in given}
            config = OmegaConf.masked_copy(config, [*taken & set(config), *self.groups])
        OmegaConf.set_struct(config, False)
        named = config.pop("modules", None) or []
        modules = [named] if isinstance(named, str) else [str(module) for module in named]
        for module in modules:
            import_module(module)
        modules += [*list_modules(OmegaConf.to_container(config)), *_search_modules(overrides)]
        if self.stored is not None:
            values = {override.key_or_group: override.value() for override in given}
            for name, value in self.stored(values).items():
                config[name] = value
            for key, value in values.items():
                if key not in (*self.groups, "modules"):
                    OmegaConf.update(config, key, value, force_add=True)
        return self._check(config, modules)

    def prepare(self, arguments: Sequence[str]) -> list[str]:
        """Write a command line as overrides for hydra, which may name any key."""
        names = [entry.name for entry in fields(self.schema)]
        if self.others is not None:
            rest = [word for word in arguments if word.partition("=")[0] not in names]
            quoted = ",".join(quote(word) for word in rest)
            own = [word for word in arguments if word not in rest]
            arguments = [*own, f"{self.others}=[{quoted}]"]
        options = split_options(arguments)
        overrides = [self._as_override(word, [*names, "modules"]) for word in options.overrides]
        if options.config_dir is not None:
            folder = Path(options.config_dir).expanduser().resolve()
            if not folder.is_dir():
                raise ValueError(f"--config-dir {options.config_dir}: there is no such folder")
            overrides.append(f"hydra.searchpath=['file://{folder}']")
        quiet = [{"override hydra/job_logging": "none"}, {"override hydra/hydra_logging": "none"}]
        groups = [{name: choice} for name, choice in self.groups.items()]
        output = {"run": {"dir": "."}, "output_subdir": None}
        node: Any = {"defaults": ["_self_", *groups, *quiet], "hydra": output}
        ConfigStore.instance().store(name=PRIMARY, node=node)
        return overrides

    def _as_override(self, word: str, known: Sequence[str]) -> str:
        key, equals, _ = word.lstrip("+").partition("=")
        if not equals and self.positional is not None:
            return f"++{self.positional}={quote(word)}"
        if not (key and equals) and not word.startswith("~"):
            raise ValueError(f"{word!r}: settings are given as key=value, without spaces")
        if word.startswith(("~", "hydra")) or key in self.groups or "/" in key or "@" in key:
            return word
        if key.split(".", 1)[0] not in known:
            raise unknown(key, known)
        return f"++{word.lstrip('+')}"

    def _check(self, config: DictConfig, modules: Sequence[str]) -> DictConfig:
        base = OmegaConf.structured(self.schema)
        OmegaConf.set_readonly(base, False)  # as that of a frozen dataclass is
        for name, kind in KINDS.items():
            if name in self.groups and OmegaConf.is_dict(config.get(name)):
                base[name] = make_schema(config[name], name, kind=kind, modules=modules)
        given = list(list_values(OmegaConf.to_container(config)))
        for key, value in given:
            if is_huge(value):
                raise ValueError(f"{key}={value}: must be {FITTING}")
        try:
            merged = OmegaConf.merge(base, config)
            OmegaConf.resolve(merged)
        except OmegaConfBaseException as error:
            raise explain(error, list_keys(base), config) from error
        for key, value in given:
            if type(value) is int and isinstance(OmegaConf.select(merged, key), bool):
                raise ValueError(f"{key}={value}: must be true or false")
        return cast(DictConfig, merged)


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        raise ValueError(message)


def split_options(arguments: Sequence[str]) -> argparse.Namespace:
    """Return the options of a command line, named as hydra's, and its ``overrides``."""
    parser = _Parser(add_help=False, allow_abbrev=False)
    parser.add_argument("overrides", nargs="*")
    parser.add_argument("--config-dir", "-cd")
    parser.add_argument("--cfg", "-c", choices=["job"])
    for long, short in (("--help", "-h"), ("--multirun", "-m")):
        parser.add_argument(long, short, action="store_true")
    return parser.parse_intermixed_args(list(arguments))


def list_modules(node: Any) -> Iterator[str]:
    """List the module of each ``_target_`` in nested plain settings."""
    if isinstance(node, Mapping):
        if TARGET in node:
            yield str(node[TARGET]).rpartition(".")[0]
        node = list(node.values())
    for value in node if isinstance(node, list) else ():
        yield from list_modules(value)


def _search_modules(overrides: Iterable[str]) -> Iterator[str]:
    """List the modules that YAML files in folders of the user name."""
    places = [line for line in overrides if line.startswith("hydra.searchpath=")]
    for folder in re.findall(r"file://([^'\",\]]+)", " ".join(places)):
        for path in Path(folder).rglob("*.yaml"):
            text = path.read_text(encoding="utf-8")
            yield from re.findall(rf"{TARGET}: *['\"]?([\w.]+)\.\w+", text)


def make_schema(node: Any, path: str, *, kind: Any, modules: Sequence[str]) -> Any:
    """Return the schema of a ``_target_`` and of those nested in it.

    Args:
        node: ``_target_`` and the arguments that YAML files and command line name. Objects that
            a field of a dataclass makes by default are added; where the ``_target_`` of another
            argument is left out, the type in the signature is taken.
        path: of the node, for messages.
        kind: see ``description.make``.
        modules: see ``description.make``.
    """
    if TARGET not in node:
        raise ValueError(f"{path}: its YAML file must begin with _target_: <module>.<class>")
    kinds = kind if isinstance(kind, tuple) else (kind,)
    made = find_class(str(node[TARGET]), kinds, modules=modules)
    entries: list[Any] = [(TARGET, str, field(default=str(node[TARGET])))]
    below: dict[str, Any] = {}
    for name, default in _list_parts(made):
        given = node.setdefault(name, default)
        if OmegaConf.is_dict(given) and TARGET not in given:
            node[name] = OmegaConf.merge(default, given)
    for name, hint, default, _ in list_fields(made):
        value = node.get(name)
        is_object = OmegaConf.is_dict(value)
        if is_object and TARGET not in value and inspect.isclass(hint) and hint is not dict:
            value[TARGET] = f"{hint.__module__}.{hint.__qualname__}"
        if is_object and TARGET in value:
            kinds = tuple(list_classes(hint))
            below[name] = make_schema(value, f"{path}.{name}", kind=kinds, modules=modules)
            entries.append((name, Any, field(default=None)))
        elif _is_plain(default):
            wanted = get_args(hint)  # of a tuple, whose length omegaconf does not check
            is_fixed = get_origin(hint) is tuple and Ellipsis not in wanted
            if is_fixed and OmegaConf.is_list(value) and len(value) != len(wanted):
                raise ValueError(f"{path}.{name}={list(value)}: must hold {len(wanted)} values")
            default = MISSING if default is REQUIRED else default
            entries.append((name, _as_type(hint), field(default_factory=partial(_list, default))))
        elif name in node:
            entries.append((name, Any, field(default=None)))
    base = OmegaConf.structured(make_dataclass(made.__name__, entries))
    for name, schema in below.items():
        base[name] = schema
    return base


def _list_parts(made: type) -> Iterator[tuple[str, dict[str, Any]]]:
    """List the objects that fields of a dataclass make by default, described."""
    for name, _, default, _ in list_fields(made):
        if isinstance(default, Settings):
            yield name, to_plain(default)


def _list(value: Any) -> Any:
    return [_list(entry) for entry in value] if isinstance(value, tuple) else value


def _is_plain(value: Any) -> bool:
    """Tell whether a YAML file can hold a default."""
    if isinstance(value, tuple):
        return all(_is_plain(entry) for entry in value)
    plain = (bool, int, float, str, type(None))
    return value is REQUIRED or isinstance(value, plain)


def _as_type(hint: Any) -> Any:
    """Return the type for omegaconf to check; ``Any`` for those it does not know."""
    try:
        OmegaConf.structured(make_dataclass("Probe", [("value", hint, field(default=MISSING))]))
    except OmegaConfBaseException:
        return Any
    return hint


def quote(value: str) -> str:
    """Write a value so that hydra reads it as it is: a plain path bare, others in quotes."""
    if re.fullmatch(r"[\w.~+-]*/[\w./~+-]*", value, re.ASCII):
        return value
    return QuotedString(value, Quote.single).with_quotes()


def parse(overrides: Iterable[str]) -> list[Override]:
    """Parse overrides ``key=value`` as hydra does, without its own settings."""
    lines = [line for line in overrides if not line.startswith("hydra")]
    try:
        return OverridesParser.create().parse_overrides(lines)
    except HydraException as error:
        raise explain(error) from error


def list_values(node: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """List the plain values in nested settings, those in lists one by one, each with its key."""
    if isinstance(node, Mapping):
        for name, value in node.items():
            yield from list_values(value, f"{path}.{name}" if path else str(name))
    elif isinstance(node, list):
        for value in node:
            yield from list_values(value, path)
    else:
        yield path, node


def list_keys(config: DictConfig, prefix: str = "") -> list[str]:
    """List all keys, those below others with dots."""
    keys = []
    for name in config:
        key = prefix + str(name)
        keys.append(key)
        if not OmegaConf.is_missing(config, name) and OmegaConf.is_dict(config[name]):
            keys += list_keys(config[name], f"{key}.")
    return keys


def explain(
    error: Exception, known: Sequence[str] = (), config: DictConfig | None = None
) -> ValueError:
    """Turn an error of hydra or omegaconf, in a merge of ``config``, into one line."""
    if isinstance(error.__cause__, MissingConfigException | OmegaConfBaseException):
        error = error.__cause__
    if isinstance(error, MissingConfigException) and error.options:
        return unknown(str(error.missing_cfg_file).rpartition("/")[2], error.options)
    key = getattr(error, "full_key", None)
    if isinstance(error, ConfigKeyError) and key:
        return unknown(key, known)
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    if not key:
        return ValueError(" ".join(lines).replace("'++", "'"))
    given = "" if config is None else f"={OmegaConf.select(config, key)}"
    problem = "must be a list, in brackets" if "not a ListConfig" in lines[0] else lines[0]
    return ValueError(f"{key}{given}: {problem}")


def unknown(key: str, known: Iterable[str]) -> ValueError:
    """Return the error for an unknown key, with the nearest right one or what there is."""
    known, place = list(known), key.rpartition(".")[0]
    beside = [name.rpartition(".")[2] for name in known if name.rpartition(".")[0] == place]
    there = f". There is: {', '.join(beside)}" if beside else ""
    return ValueError(f"there is no {key!r}{suggest(key, known) or there}")
