"""Settings of the programs: hydra composes them, constructors are the schema.

A program has a dataclass as its schema and may take groups of YAML files (``task``, ``preset``,
``algorithm``, ``logger``). What a YAML file or the command line sets below a ``_target_`` is
checked against the signature of the constructor it names; every plain default is filled in.
From weakest to strongest: defaults of constructors, files of a group such as ``task=<name>``, the
preset that was asked for, the command line.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, make_dataclass
from difflib import SequenceMatcher
from functools import cache, partial
from pathlib import Path
from typing import Any, cast, get_args, get_origin

from hydra import compose, initialize_config_dir
from hydra._internal.utils import get_args_parser
from hydra.core.config_store import ConfigStore
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.errors import HydraException, InstantiationException, MissingConfigException
from hydra.utils import get_object, instantiate
from omegaconf import MISSING, DictConfig, OmegaConf
from omegaconf.errors import ConfigKeyError, OmegaConfBaseException
from yaml import YAMLError  # type: ignore[import-untyped]

CONF = Path(__file__).parent / "conf"
#: Name under which hydra finds the defaults list of the program that runs.
PRIMARY = "program"

Settings = Mapping[str, Any]


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
    """

    schema: type
    groups: Mapping[str, str | None] = field(default_factory=dict)
    is_training: bool = False
    stored: Callable[[Settings], Settings] | None = None
    positional: str | None = None

    def read(self, arguments: Sequence[str] = ()) -> Any:
        """Return the settings of a command line, an instance of ``schema``.

        Args:
            arguments: see ``compose``.

        Raises:
            ValueError: for an unknown key, choice or type, and for values out of range.
        """
        return self.make(self.compose(arguments))

    def compose(self, arguments: Sequence[str] = ()) -> DictConfig:
        """Compose a command line and check its keys and types.

        Args:
            arguments: ``key=value`` each, and ``--config-dir <folder>`` for your own YAML
                files, ``<folder>/task/<name>.yaml``.

        Raises:
            ValueError: for an unknown key, choice or type.
        """
        overrides = self.prepare(arguments)
        try:
            with initialize_config_dir(str(CONF), version_base="1.3"):
                config = compose(PRIMARY, overrides)
        except (HydraException, OmegaConfBaseException, YAMLError) as error:
            raise explain(error) from error
        return self.check(config, overrides)

    def prepare(self, arguments: Sequence[str]) -> list[str]:
        """Write a command line as overrides for hydra, which may name any key."""
        options = get_args_parser().parse_intermixed_args(list(arguments))
        overrides = [self._as_override(word) for word in options.overrides]
        if options.config_dir is not None:
            folder = Path(options.config_dir).expanduser().resolve()
            if not folder.is_dir():
                raise ValueError(f"--config-dir {options.config_dir}: there is no such folder")
            overrides.append(f"hydra.searchpath=['file://{folder}']")
        self.register()
        return overrides

    def register(self) -> None:
        """Tell hydra the defaults list of this program."""
        quiet = [{"override hydra/job_logging": "none"}, {"override hydra/hydra_logging": "none"}]
        groups = [{name: choice} for name, choice in self.groups.items()]
        output = {"run": {"dir": "."}, "output_subdir": None}
        node: Any = {"defaults": ["_self_", *groups, *quiet], "hydra": output}
        ConfigStore.instance().store(name=PRIMARY, node=node)

    def make(self, config: DictConfig) -> Any:
        """Make the settings, which check their ranges.

        Raises:
            ValueError: for a value that is missing or out of range.
        """
        missing = sorted(OmegaConf.missing_keys(config))
        if missing:
            raise ValueError(f"{missing[0]}: has no default; give {missing[0]}=<value>")
        return self.schema(**cast(dict[str, Any], OmegaConf.to_container(config)))

    def check(self, config: DictConfig, overrides: Iterable[str]) -> DictConfig:
        """Check keys and types of a composed config, and fill in the defaults.

        Args:
            config: as hydra composed it.
            overrides: of the command line.

        Raises:
            ValueError: see ``compose``.
        """
        given = parse(line for line in overrides if not line.startswith("hydra"))
        taken = {override.key_or_group.split(".", 1)[0] for override in given}
        if not self.is_training:
            config = OmegaConf.masked_copy(config, [*taken & set(config), *self.groups])
        OmegaConf.set_struct(config, False)
        if self.stored is not None:
            values = {o.key_or_group: o.value() for o in given}
            for name, value in self.stored(values).items():
                config[name] = value
            for override in given:
                if override.key_or_group not in self.groups:
                    key, value = override.key_or_group, override.value()
                    OmegaConf.update(config, key, value, force_add=True)
        base = OmegaConf.structured(self.schema)
        OmegaConf.set_readonly(base, False)  # as that of a frozen dataclass is
        for name in self.groups:
            node = config.get(name)
            if OmegaConf.is_dict(node) and name != "preset":
                base[name] = make_schema(node, name)
        try:
            merged = OmegaConf.merge(base, config)
            OmegaConf.resolve(merged)
        except OmegaConfBaseException as error:
            raise explain(error, list_keys(base), config) from error
        return cast(DictConfig, merged)

    def _as_override(self, word: str) -> str:
        key = word.lstrip("+").split("=", 1)[0]
        if "=" not in word and self.positional is not None:
            escaped = word.replace("\\", "\\\\").replace("'", "\\'")
            return f"++{self.positional}='{escaped}'"
        if word.startswith(("~", "hydra")) or key in self.groups or "/" in key or "@" in key:
            return word
        known = [entry.name for entry in fields(self.schema)]
        if key.split(".", 1)[0] not in known:
            raise unknown(key, known)
        return f"++{word.lstrip('+')}"


def make_schema(node: Any, path: str) -> Any:
    """Return the schema of a ``_target_`` and of those nested in it.

    Args:
        node: ``_target_`` and the arguments that YAML files and command line name. Where the
            ``_target_`` of an argument is left out, the type in the signature is taken.
        path: of the node, for messages.

    Raises:
        ValueError: if there is no such object.
    """
    if "_target_" not in node:
        raise ValueError(f"{path}: its YAML file must begin with _target_: <module>.<class>")
    target = str(node["_target_"])
    try:
        made = get_object(target)
        parameters = inspect.signature(made, eval_str=True).parameters.values()
    except (ImportError, ValueError, TypeError) as error:
        raise ValueError(
            f"{path}._target_={target}: {' '.join(str(error).split())} (is its folder on "
            "PYTHONPATH?)"
        ) from error
    entries: list[Any] = [("_target_", str, field(default=target))]
    below: dict[str, Any] = {}
    for parameter in parameters:
        name, hint, value = parameter.name, parameter.annotation, node.get(parameter.name)
        if parameter.kind is parameter.VAR_KEYWORD:
            return node
        is_object = OmegaConf.is_dict(value)
        if is_object and "_target_" not in value and inspect.isclass(hint) and hint is not dict:
            value["_target_"] = f"{hint.__module__}.{hint.__qualname__}"
        if is_object and "_target_" in value:
            below[name] = make_schema(value, f"{path}.{name}")
            entries.append((name, Any, field(default=None)))
        elif is_plain(parameter.default):
            _check_length(value, hint, f"{path}.{name}")
            default = MISSING if parameter.default is parameter.empty else parameter.default
            entries.append((name, as_type(hint), field(default_factory=partial(_list, default))))
        elif name in node:
            entries.append((name, Any, field(default=None)))
    base = OmegaConf.structured(make_dataclass(made.__name__, entries))
    for name, schema in below.items():
        base[name] = schema
    return base


def _list(value: Any) -> Any:
    return [_list(entry) for entry in value] if isinstance(value, tuple) else value


def is_plain(value: Any) -> bool:
    """Tell whether a YAML file can hold a default."""
    if isinstance(value, tuple):
        return all(is_plain(entry) for entry in value)
    plain = (bool, int, float, str, type(None))
    return value is inspect.Parameter.empty or isinstance(value, plain)


@cache
def as_type(hint: Any) -> Any:
    """Return the type for omegaconf to check; ``Any`` for those it does not know."""
    try:
        OmegaConf.structured(make_dataclass("Probe", [("value", hint, field(default=MISSING))]))
    except OmegaConfBaseException:
        return Any
    return hint


def _check_length(value: Any, hint: Any, path: str) -> None:
    """Check a list against a tuple of fixed length, which omegaconf does not."""
    wanted = get_args(hint)
    is_fixed = get_origin(hint) is tuple and Ellipsis not in wanted
    if is_fixed and OmegaConf.is_list(value) and len(value) != len(wanted):
        raise ValueError(f"{path}={list(value)}: must hold {len(wanted)} values")


def parse(overrides: Iterable[str]) -> list[Override]:
    """Parse overrides as hydra does.

    Raises:
        ValueError: for anything but ``key=value``.
    """
    try:
        return OverridesParser.create().parse_overrides(list(overrides))
    except HydraException as error:
        raise explain(error) from error


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
    """Turn an error of hydra or omegaconf into one line, with the nearest right word for a typo.

    Args:
        error: of composition or merge.
        known: existing keys.
        config: what was merged.
    """
    if isinstance(error.__cause__, MissingConfigException | OmegaConfBaseException):
        error = error.__cause__
    if isinstance(error, MissingConfigException) and error.options:
        name = str(error.missing_cfg_file).rpartition("/")[2]
        return unknown(name, error.options)
    key = getattr(error, "full_key", None)
    if isinstance(error, ConfigKeyError) and key:
        return unknown(key, known)
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    if not key:
        return ValueError(" ".join(lines))
    value = None if config is None else OmegaConf.select(config, key)
    return ValueError(f"{key}={value}: {lines[0]}")


def unknown(key: str, known: Iterable[str]) -> ValueError:
    """Return the error for an unknown key."""
    return ValueError(f"there is no {key!r}.{nearest(key, known)}")


def nearest(word: str, known: Iterable[str]) -> str:
    """Return `` Did you mean 'x'?`` for the most similar word; without one, what there is.

    Dotted keys are compared as a whole and by their last part.
    """
    known, (place, _, tail) = list(known), word.rpartition(".")

    def likeness(one: str, other: str) -> float:
        return SequenceMatcher(None, one, other).ratio()

    def rate(other: str) -> float:
        return likeness(word, other) + likeness(tail, other.rpartition(".")[2])

    best = max(known, key=rate, default="")
    if likeness(tail, best.rpartition(".")[2]) >= 0.6:
        return f" Did you mean {best!r}?"
    beside = [name.rpartition(".")[2] for name in known if name.rpartition(".")[0] == place]
    return f" There is: {', '.join(beside)}." if beside else ""


def build(node: Settings) -> Any:
    """Make the object that a ``_target_`` of the command line or a YAML file names.

    Raises:
        ValueError: from the object's own checks, and if it does not take these arguments.
        ImportError: if there is no such object.
    """
    try:
        return instantiate(dict(node), _convert_="all")
    except InstantiationException as error:
        cause = error.__cause__
        if isinstance(cause, ValueError | ImportError):
            raise cause from error
        raise ValueError(" ".join(str(error).split())) from error


def to_plain(settings: Any) -> dict[str, Any]:
    """Turn settings into nested dicts, to write to a file."""
    plain = OmegaConf.to_container(OmegaConf.structured(settings), resolve=True)
    return cast(dict[str, Any], plain)
