"""Words of a command line, each compared with what there is, and answered where it is wrong."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from importlib import import_module
from inspect import Parameter, signature
from itertools import product
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Glob, Override
from hydra.errors import OverrideParseException
from hydra.utils import get_object
from omegaconf import DictConfig, OmegaConf

from experiments.search_path import list_program_groups, select_search_path
from experiments.settings import ConfigError, nearest
from experiments.sweeps.jobs import is_sweep

#: Packages of the launchers beside hydra's own.
LAUNCHERS = {
    "joblib": "hydra_plugins.hydra_joblib_launcher",
    "submitit_local": "hydra_plugins.hydra_submitit_launcher",
    "submitit_slurm": "hydra_plugins.hydra_submitit_launcher",
}


def parse_overrides(settings: Sequence[str]) -> list[Override]:
    """Parse settings as hydra does.

    Raises:
        ConfigError: naming one that is none.
    """
    try:
        return OverridesParser.create().parse_overrides(list(settings))
    except OverrideParseException as error:
        raise ConfigError(
            f"{error.override!r}: settings are written key=value, such as seed=1"
        ) from error


def check_options(program: str, options: Sequence[str]) -> None:
    """Check hydra's options: who may sweep, and with which launcher.

    Raises:
        ConfigError: saying what is allowed, or what to install.
    """
    for option in options:
        if program != "train" and is_sweep([option]):
            raise ConfigError(f"{option}: {_say_runs_once(program)}")
        key, _, launcher = option.partition("=")
        if key != "hydra/launcher" or launcher == "basic":
            continue
        if launcher not in LAUNCHERS:
            raise _unknown(option, launcher, ["basic", *LAUNCHERS])
        try:
            import_module(LAUNCHERS[launcher])
        except ImportError as error:
            raise ConfigError(
                f"{option}: needs a package that is not here; pip install -e '.[sweep]'"
            ) from error


def check_single(program: str, overrides: Sequence[Override]) -> None:
    """Refuse several values of a setting, where no sweep is asked for."""
    for override in overrides:
        if not override.is_sweep_override():
            continue
        line = override.input_line
        if program != "train":
            raise ConfigError(f"{line}: {_say_runs_once(program)}")
        raise ConfigError(
            f"{line}: several values need --multirun; a list stands in brackets, as hidden=[64,64]"
        )


def read_choices(
    program: str,
    overrides: Sequence[Override],
    *,
    groups: Mapping[str, Sequence[str]],
    options: Sequence[str],
) -> dict[str, list[str]]:
    """Return what is chosen of each group on a command line: one value, or those of a sweep.

    Args:
        program: whose command line it is.
        overrides: of it.
        groups: all that there are, and what there is to choose in each.
        options: of hydra, on the same command line.

    Raises:
        ConfigError: for a group that the program has not, and for a value that is not there.
    """
    own = list_program_groups(program)
    is_folder_given = bool(select_search_path(options))
    choices: dict[str, list[str]] = {}
    for override in overrides:
        key = override.key_or_group
        group = key.split(".", 1)[0]
        if group in groups and group not in own:
            raise ConfigError(
                f"{override.input_line}: experiments.{program} has no group {group!r}; "
                f"it has {', '.join(own)}"
            )
        if key in groups:
            choices[key] = _list_values(override, groups[key])
            for value in choices[key]:
                if value not in groups[key]:
                    advice = "" if is_folder_given else _OWN.get(key, "")
                    raise _unknown(f"{key}={value}", value, groups[key], advice=advice)
    return choices


#: What is added where a name of a group is not known.
_OWN = dict.fromkeys(("task", "preset"), " One of your own needs --config-dir <folder>.")


def _list_values(override: Override, known: Sequence[str]) -> list[str]:
    value = override.value()
    if isinstance(value, Glob):
        return list(value.filter(list(known)))
    if override.is_sweep_override():
        return [str(one) for one in override.sweep_iterator()]
    return [str(value)]


def combine(choices: Mapping[str, Sequence[str]]) -> Iterator[dict[str, str]]:
    """Give every combination of the values that are chosen of groups."""
    for values in product(*choices.values()):
        yield dict(zip(choices, values, strict=True))


def check_key(
    base: DictConfig,
    override: Override,
    *,
    known: Sequence[str],
    lists: Collection[str],
    swept: Mapping[str, str],
) -> None:
    """Check that there is such a key, and that its value is of the right kind.

    Args:
        base: everything that can be set.
        override: of a key, not of a group.
        known: keys and groups there are.
        lists: those of them that take lists, whatever their default is.
        swept: of the groups that a sweep varies, the value that ``base`` is made with.

    Raises:
        ConfigError: naming the nearest right key, or what is allowed.
    """
    key = override.key_or_group
    if key not in known:
        group = key.split(".", 1)[0]
        where = f" ({group}={swept[group]})" if group in swept else ""
        raise _unknown_key(base, key, known, where=where)
    if not override.is_sweep_override():
        value = override.value()
        is_reference = isinstance(value, str) and "${" in value
        if not is_reference and value is not None:
            _check_list(base, key, value, is_listed=key in lists)
            _check_type(base, key, value)


def list_keys(config: DictConfig, prefix: str = "") -> set[str]:
    """Return all keys of a configuration, those inside others with dots."""
    keys: set[str] = set()
    for name in config:
        key = prefix + str(name)
        keys.add(key)
        if not OmegaConf.is_missing(config, name) and OmegaConf.is_dict(config[name]):
            keys |= list_keys(config[name], f"{key}.")
    return keys


def check_object(config: DictConfig, group: str) -> None:
    """Check that what YAML files say of a group names an object, and only arguments of it.

    Args:
        config: everything that can be set.
        group: task, algorithm or logger.

    Raises:
        ConfigError: naming what is missing, or the nearest right argument.
    """
    node: Any = None if OmegaConf.is_missing(config, group) else config[group]
    if not OmegaConf.is_dict(node) or "_target_" not in node:
        raise ConfigError(
            f"{group}: no _target_ says what to make; begin its YAML with "
            "_target_: <module>.<class>."
        )
    unfit = find_unfit(node, group)
    if unfit is None:
        return
    without: Any = OmegaConf.create(OmegaConf.to_container(config))
    parent, _, name = unfit.rpartition(".")
    del OmegaConf.select(without, parent)[name]
    raise _unknown_key(without, unfit, sorted(list_keys(without)), where="")


def find_unfit(node: Mapping[str, Any], path: str) -> str | None:
    """Return the first key below a ``_target_`` that is no argument of it, or None.

    Args:
        node: ``_target_`` and arguments.
        path: of the node, with dots.
    """
    parameters: Mapping[str, Parameter] = {}
    if "_target_" in node:
        parameters = signature(get_object(str(node["_target_"]))).parameters
        if any(one.kind is Parameter.VAR_KEYWORD for one in parameters.values()):
            parameters = {}
    for name, value in node.items():
        if parameters and name != "_target_" and name not in parameters:
            return f"{path}.{name}"
        if isinstance(value, Mapping):
            unfit = find_unfit(value, f"{path}.{name}")
            if unfit is not None:
                return unfit
    return None


def _check_list(config: DictConfig, key: str, value: Any, *, is_listed: bool) -> None:
    """Refuse what is no list where one is meant, or not as many numbers as there have to be."""
    default = OmegaConf.select(config, key)
    if not (is_listed or OmegaConf.is_list(default)):
        return
    shown = f", such as {str(list(default)).replace(' ', '')}" if default else ""
    if not isinstance(value, list):
        raise ConfigError(f"{key}={value}: must be a list in brackets{shown}")
    num_numbers = _count_numbers(config, key)
    are_numbers = all(isinstance(n, int | float) and not isinstance(n, bool) for n in value)
    if num_numbers and not (are_numbers and len(value) == num_numbers):
        raise ConfigError(f"{key}={value}: must be a list of {num_numbers} numbers{shown}")


def _count_numbers(config: DictConfig, key: str) -> int:
    """Return how many numbers an argument takes that is a tuple of fixed length; of others, 0."""
    parent, _, name = key.rpartition(".")
    node: Any = OmegaConf.select(config, parent) if parent else None
    if not OmegaConf.is_dict(node) or "_target_" not in node:
        return 0
    parameters = signature(get_object(str(node["_target_"]))).parameters
    kind = str(parameters[name].annotation) if name in parameters else ""
    return kind.count("float") if _FIXED.fullmatch(kind) else 0


#: How the type of a tuple is written that holds so many numbers and no others.
_FIXED = re.compile(r"tuple\[float(, float)*\]")


def _check_type(config: DictConfig, key: str, value: Any) -> None:
    """Compare a new value with the default it replaces, where that says what is meant."""
    default = OmegaConf.select(config, key)
    for kind, allowed, words in (
        (bool, bool, "true or false"),
        (int, int, "a whole number"),
        (float, (int, float), "a number"),
    ):
        if isinstance(default, kind):
            is_right = isinstance(value, allowed) and (kind is bool or not isinstance(value, bool))
            if not is_right:
                raise ConfigError(f"{key}={value}: must be {words}, such as {default}")
            return


def _unknown(what: str, word: str, known: Sequence[str], *, advice: str = "") -> ConfigError:
    listed = f" There is: {', '.join(known)}." if len(known) < 12 else ""
    return ConfigError(f"{what}: there is no {word!r}.{nearest(word, known)}{listed}{advice}")


def _unknown_key(config: DictConfig, key: str, known: Sequence[str], *, where: str) -> ConfigError:
    """Name the object that has no such argument, and the nearest one or those that it has."""
    names = key.split(".")
    nodes = [OmegaConf.select(config, ".".join(names[:end])) for end in range(1, len(names))]
    objects = [node for node in nodes if OmegaConf.is_dict(node) and "_target_" in node]
    known = [name for name in known if not name.endswith("._target_")]
    if not objects:
        return _unknown(f"{key}=...", key, known)
    kind = str(objects[-1]["_target_"]).rsplit(".", 1)[-1]
    taken = ", ".join(str(name) for name in objects[-1] if name != "_target_") or "nothing"
    advice = ("" if where else nearest(key, known)) or f" It takes {taken}."
    return ConfigError(f"{key}=...: there is no {key!r} in {kind}{where}.{advice}")


def _say_runs_once(program: str) -> str:
    return (
        f"experiments.{program} runs once; give one command for each value, or sweep over "
        "trainings with experiments.train"
    )
