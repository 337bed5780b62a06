"""From command line to settings: what there is to set, and what a typo was meant to be."""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from dataclasses import fields
from importlib import import_module
from typing import Any, cast

from hydra import compose, initialize_config_dir
from hydra.core.config_store import ConfigStore
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.errors import HydraException, OverrideParseException
from hydra.utils import get_object
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError  # type: ignore[import-untyped]

from experiments.run_folder import RunFolder
from experiments.search_path import CONF, list_groups, select_search_path, split_arguments
from experiments.settings import (
    ConfigError,
    EvaluateConfig,
    LateralLineConfig,
    TrainConfig,
    ViewConfig,
    nearest,
)
from experiments.sweeps.jobs import is_sweep

#: Settings that the saved state of a run depends on, or that it brings with it.
FIXED_BY_RUN = (
    *("task", "preset", "seed", "num_envs", "hidden", "buffer_size", "logger", "recognition"),
    *("algorithm", "ray_collectors", "learning_rate", "gamma", "tau", "batch_size"),
    *("warmup_frames", "updates_per_frame"),
)
#: Packages of the launchers beside hydra's own.
LAUNCHERS = {
    "joblib": "hydra_plugins.hydra_joblib_launcher",
    "submitit_local": "hydra_plugins.hydra_submitit_launcher",
    "submitit_slurm": "hydra_plugins.hydra_submitit_launcher",
}

SCHEMAS: dict[str, type] = {
    "train": TrainConfig,
    "evaluate": EvaluateConfig,
    "train_lateral_line": LateralLineConfig,
    "view": ViewConfig,
}
ConfigStore.instance().store(name="train_schema", node=TrainConfig)
ConfigStore.instance().store(name="train_lateral_line_schema", node=LateralLineConfig)
# Plain, so that a preset may also set what only training reads.
for _program in ("evaluate", "view"):
    ConfigStore.instance().store(
        name=f"{_program}_schema",
        node=OmegaConf.to_container(OmegaConf.structured(SCHEMAS[_program])),
    )


def check_overrides(program: str, arguments: Sequence[str]) -> list[str]:
    """Check a command line against everything that can be set, before hydra sees it.

    Every argument of a ``_target_``'s constructor can be set, whether the YAML names it or not.
    Settings of the task are those of the run that is evaluated or shown, if there is one; those
    that a resumed run has fixed are refused.

    Args:
        program: train, evaluate, view or train_lateral_line.
        arguments: the command line; options of hydra (``--multirun``, ``hydra.x=y``) pass as is.
            ``--config-dir <folder>`` adds a folder with groups (``task/<name>.yaml``) of one's own.

    Returns:
        The command line for hydra.

    Raises:
        ConfigError: naming an unknown key or value and the nearest right one, or what is fixed.
        ValueError: if there is no such run.
    """
    options, settings = split_arguments(arguments)
    _check_sweep(program, options)
    _check_launcher(options)
    try:
        overrides = OverridesParser.create().parse_overrides(settings)
    except OverrideParseException as error:
        raise ConfigError(
            f"{error.override!r}: settings are written key=value, such as seed=1"
        ) from error
    _check_resume(program, overrides)
    groups = list_groups(options)
    chosen = select_search_path(options)
    for override in overrides:
        if override.key_or_group in groups:
            known = groups[override.key_or_group]
            values = (
                [str(value) for value in override.sweep_iterator()]
                if override.is_sweep_override()
                else [str(override.value())]
            )
            for value in values:
                if value not in known:
                    raise _unknown(f"{override.key_or_group}={value}", value, known)
            chosen.append(f"{override.key_or_group}={values[0]}")
    base = with_defaults(program, _compose(program, chosen))
    own = _find_own_task(program, overrides)
    if own is not None:
        base.task = own
        base = with_defaults(program, base)
    known_keys = sorted(_keys(base))
    result = list(options)
    for override in overrides:
        key, line = override.key_or_group, str(override.input_line)
        if key not in groups:
            if key not in known_keys:
                raise _unknown_key(base, key, [*known_keys, *groups])
            _check_type(base, key, override.value(), is_sweep=override.is_sweep_override())
            if key.startswith(("task.", "logger.", "algorithm.")):
                line = "++" + line.lstrip("+")  # an argument that the YAML leaves at its default
        result.append(line)
    return result


def _find_own_task(program: str, overrides: Sequence[Override]) -> Any:
    """Return the task of the run or checkpoint that is given, or None if another one is chosen."""
    given = {override.key_or_group: override for override in overrides}
    known = {entry.name for entry in fields(SCHEMAS[program])}
    fish = [name for name in ("run", "checkpoint", "policy") if name in known & set(given)]
    if len(fish) != 1 or "policy" in fish or {"task", "preset"} & set(given):
        return None
    from experiments.checkpointing import read_metadata  # slow, as it brings torchrl

    return read_metadata(str(given[fish[0]].value()))[1]["config"]["task"]


def _check_resume(program: str, overrides: Sequence[Override]) -> None:
    """Refuse what a resumed run has fixed, whatever its task and algorithm are."""
    for override in overrides:
        is_known = program == "train" and override.key_or_group == "resume"
        if is_known and not override.is_sweep_override() and override.value() is not None:
            _check_fixed(str(override.value()), [str(other.input_line) for other in overrides])


def _check_fixed(folder: str, arguments: Sequence[str]) -> RunFolder:
    run = RunFolder.of_existing(folder)
    for argument in arguments:
        name = argument.lstrip("+~").split("=", 1)[0].split(".", 1)[0]
        if name in FIXED_BY_RUN:
            raise ConfigError(
                f"{argument.lstrip('+')}: {name} is fixed in {folder}; leave it away, or start a "
                "new run"
            )
    return run


def change_task(task: Mapping[str, Any], arguments: Sequence[str]) -> dict[str, Any]:
    """Put settings of a command line on top of a task.

    Args:
        task: ``_target_`` and arguments.
        arguments: checked overrides; those of ``task.`` are taken.
    """
    given = [argument for argument in arguments if argument.lstrip("+").startswith("task.")]
    changed = OmegaConf.create({"task": dict(task)})
    for override in OverridesParser.create().parse_overrides(given):
        OmegaConf.update(changed, override.key_or_group, override.value(), force_add=True)
    return cast(dict[str, Any], OmegaConf.to_container(changed.task, resolve=True))


def load_config(program: str, arguments: Sequence[str] = ()) -> Any:
    """Compose the settings of a program as its command line would.

    Args:
        program: train, evaluate, view or train_lateral_line.
        arguments: overrides.

    Returns:
        The settings: a ``TrainConfig``, ``EvaluateConfig``, ``ViewConfig`` or
        ``LateralLineConfig``.

    Raises:
        ConfigError: for unknown keys and values, and for values out of range.
    """
    return to_settings(program, _compose(program, check_overrides(program, arguments)))


def to_settings(program: str, config: DictConfig) -> Any:
    """Turn a composed configuration into its dataclass, with every default spelled out.

    Raises:
        ConfigError: for values of the wrong type or out of range.
    """
    schema = OmegaConf.structured(SCHEMAS[program])
    try:
        return OmegaConf.to_object(OmegaConf.merge(schema, with_defaults(program, config)))
    except OmegaConfBaseException as error:
        raise _plain(error) from error


def resumed_settings(folder: str, arguments: Sequence[str]) -> TrainConfig:
    """Take the settings of a run that goes on, with what was given anew.

    Args:
        folder: of the run.
        arguments: checked overrides; such as ``total_frames=8000``.

    Raises:
        ConfigError: if one of them is fixed by what is already learned.
        ValueError: if there is no run in the folder.
    """
    given = [argument.lstrip("+") for argument in arguments if not argument.startswith("-")]
    path = _check_fixed(folder, given).config
    try:
        stored = cast(DictConfig, OmegaConf.load(path))
        for name in ("alpha_init", "target_entropy_weight"):  # of runs before there was a choice
            if name in stored:
                OmegaConf.update(stored, f"algorithm.{name}", stored.pop(name))
        # whoever looked on before need not look on again
        changes = OmegaConf.merge({"live": False}, OmegaConf.from_dotlist(given))
        merged = OmegaConf.merge(OmegaConf.structured(TrainConfig), stored, changes)
    except (OmegaConfBaseException, YAMLError) as error:
        raise ConfigError(f"{path}: not the configuration of a run ({error})") from error
    return cast(TrainConfig, to_settings("train", cast(DictConfig, merged)))


def to_plain(settings: Any) -> dict[str, Any]:
    """Turn settings into nested dicts, for a file."""
    plain = OmegaConf.to_container(OmegaConf.structured(settings), resolve=True)
    return cast(dict[str, Any], plain)


def build(node: Mapping[str, Any]) -> Any:
    """Make the object that a ``_target_`` names, and those among its arguments first.

    Raises:
        ConfigError: if there is nothing of that name, or it does not take these arguments.
        ValueError: from the object's own checks, as it is.
    """
    arguments = {
        name: build(value) if isinstance(value, Mapping) and "_target_" in value else value
        for name, value in node.items()
        if name != "_target_"
    }
    made = _find(node["_target_"])
    try:
        inspect.signature(made).bind(**arguments)
    except TypeError as error:
        raise ConfigError(f"{node['_target_']}: {error}") from error
    return made(**arguments)


def with_defaults(program: str, config: DictConfig) -> DictConfig:
    """Keep what the program reads, and spell out the plain defaults behind each ``_target_``."""
    filled = OmegaConf.masked_copy(config, [entry.name for entry in fields(SCHEMAS[program])])
    OmegaConf.set_struct(filled, False)
    _fill(filled)
    OmegaConf.set_struct(filled, True)
    return filled


def _fill(config: DictConfig) -> None:
    for name in config:
        if OmegaConf.is_missing(config, name) or not OmegaConf.is_dict(config[name]):
            continue
        node = config[name]
        if "_target_" in node:
            for key, default in _plain_defaults(str(node["_target_"])).items():
                if key not in node:
                    node[key] = default
        _fill(node)


def _find(target: str) -> Any:
    try:
        return get_object(target)
    except (ImportError, ValueError) as error:
        raise ConfigError(
            f"_target_={target}: {' '.join(str(error).split())} (the folder of a module of your "
            "own must be on PYTHONPATH)"
        ) from error


def _plain_defaults(target: str) -> dict[str, Any]:
    return {
        name: list(parameter.default) if isinstance(parameter.default, tuple) else parameter.default
        for name, parameter in inspect.signature(_find(target)).parameters.items()
        if parameter.default is None
        or isinstance(parameter.default, bool | int | float | str | tuple)
    }


def _compose(program: str, overrides: Sequence[str]) -> DictConfig:
    overrides = [o for o in overrides if not o.startswith("-")]
    try:
        with initialize_config_dir(str(CONF), version_base="1.3"):
            return compose(program, list(overrides))
    except (HydraException, OmegaConfBaseException) as error:
        raise _plain(error) from error


def _check_sweep(program: str, options: Sequence[str]) -> None:
    for option in options:
        if program != "train" and is_sweep([option]):
            raise ConfigError(
                f"{option}: experiments.{program} runs once; give one command for each value, or "
                "sweep over trainings with experiments.train"
            )


def _check_launcher(options: Sequence[str]) -> None:
    for option in options:
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


def _keys(config: DictConfig, prefix: str = "") -> set[str]:
    keys: set[str] = set()
    for name in config:
        key = prefix + str(name)
        keys.add(key)
        if not OmegaConf.is_missing(config, name) and OmegaConf.is_dict(config[name]):
            keys |= _keys(config[name], f"{key}.")
    return keys


def _check_type(config: DictConfig, key: str, value: Any, *, is_sweep: bool) -> None:
    """Compare a new value with the default it replaces, where that says what is meant."""
    default = OmegaConf.select(config, key)
    is_reference = isinstance(value, str) and "${" in value
    if is_sweep or is_reference or default is None or value is None:
        return
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


def _unknown(what: str, word: str, known: Sequence[str]) -> ConfigError:
    listed = f" There is: {', '.join(known)}." if len(known) < 12 else ""
    return ConfigError(f"{what}: there is no {word!r}.{nearest(word, known)}{listed}")


def _unknown_key(config: DictConfig, key: str, known: Sequence[str]) -> ConfigError:
    """Name the object that has no such argument, and the nearest one or those that it has."""
    names = key.split(".")
    nodes = [OmegaConf.select(config, ".".join(names[:end])) for end in range(1, len(names))]
    objects = [node for node in nodes if OmegaConf.is_dict(node) and "_target_" in node]
    known = [name for name in known if not name.endswith("._target_")]
    if not objects:
        return _unknown(f"{key}=...", key, known)
    kind = str(objects[-1]["_target_"]).rsplit(".", 1)[-1]
    taken = ", ".join(str(name) for name in objects[-1] if name != "_target_") or "nothing"
    advice = nearest(key, known) or f" It takes {taken}."
    return ConfigError(f"{key}=...: there is no {key!r} in {kind}.{advice}")


def _plain(error: Exception) -> ConfigError:
    """Say in one line what hydra and omegaconf say in several."""
    cause = error.__cause__ if isinstance(error.__cause__, OmegaConfBaseException) else error
    lines = [line.strip() for line in str(cause).splitlines() if line.strip()]
    key = getattr(cause, "full_key", None)
    return ConfigError(f"{key}: {lines[0]}" if key else " ".join(lines))
