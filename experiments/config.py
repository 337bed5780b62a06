"""From command line to settings: what there is to set, and what a typo was meant to be."""

from __future__ import annotations

import inspect
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import fields
from typing import Any, cast

from hydra import compose, initialize_config_dir
from hydra.core.config_store import ConfigStore
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.errors import HydraException
from hydra.utils import get_object
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError  # type: ignore[import-untyped]

from experiments.overrides import (
    check_key,
    check_object,
    check_options,
    check_single,
    combine,
    find_unfit,
    list_keys,
    parse_overrides,
    read_choices,
)
from experiments.search_path import (
    CONF,
    list_groups,
    list_program_groups,
    select_search_path,
    split_arguments,
)
from experiments.settings import (
    ConfigError,
    EvaluateConfig,
    LateralLineConfig,
    TrainConfig,
    ViewConfig,
    nearest,
)
from experiments.sweeps.jobs import is_sweep
from fishrl.training.run_folder import RunFolder

#: Settings that the saved state of a run depends on, or that it brings with it.
FIXED_BY_RUN = (
    *("task", "preset", "seed", "num_envs", "hidden", "buffer_size", "logger", "recognition"),
    *("algorithm", "ray_collectors", "learning_rate", "gamma", "tau", "batch_size"),
    *("warmup_frames", "updates_per_frame"),
)
SCHEMAS: dict[str, type] = {
    "train": TrainConfig,
    "evaluate": EvaluateConfig,
    "train_lateral_line": LateralLineConfig,
    "view": ViewConfig,
}
ConfigStore.instance().store(name="train_schema", node=TrainConfig)
# Plain, so that a preset may also set what only training reads.
for _program in ("evaluate", "train_lateral_line", "view"):
    _node: Any = OmegaConf.to_container(OmegaConf.structured(SCHEMAS[_program]))
    if _program == "train_lateral_line":  # comes after the preset, of which it leaves these alone
        _node = {name: value for name, value in _node.items() if name not in ("task", "preset")}
    ConfigStore.instance().store(name=f"{_program}_schema", node=_node)


def check_overrides(
    program: str, arguments: Sequence[str], *, is_search: bool = False
) -> list[str]:
    """Check a command line against everything that can be set, before hydra sees it.

    Every argument of a ``_target_``'s constructor can be set, whether the YAML names it or not.
    Settings of the task are those of the run that is evaluated or shown, if there is one; those
    that a resumed run has fixed are refused.

    Args:
        program: train, evaluate, view or train_lateral_line.
        arguments: the command line; options of hydra (``--multirun``, ``hydra.x=y``) pass as is.
            ``--config-dir <folder>`` adds a folder with groups (``task/<name>.yaml``) of one's own.
        is_search: whether settings may hold several values, although no sweep is asked for.

    Returns:
        The command line for hydra.

    Raises:
        ConfigError: naming an unknown key or value and the nearest right one, or what is fixed.
        ValueError: if there is no such run.
    """
    options, settings = split_arguments(arguments)
    check_options(program, options)
    overrides = parse_overrides(settings)
    _check_resume(program, overrides)
    groups = list_groups(options)
    choices = read_choices(program, overrides, groups=groups, options=options)
    if not (is_search or is_sweep(options)):
        check_single(program, overrides)
    own = _find_own_task(program, overrides)
    lists = {field.name for field in fields(SCHEMAS[program]) if str(field.type)[:5] == "list["}
    swept = {group for group, values in choices.items() if len(values) > 1}
    for chosen in combine(choices):
        base = _compose_base(program, chosen, places=select_search_path(options))
        if own is not None:
            base.task = own
            base = with_defaults(program, base)
        known = [*sorted(list_keys(base)), *list_program_groups(program)]
        varied = {group: chosen[group] for group in swept}
        for override in overrides:
            if override.key_or_group not in groups:
                check_key(base, override, known=known, lists=lists, swept=varied)
    return [*options, *(_as_line(override, groups) for override in overrides)]


def _as_line(override: Override, groups: Collection[str]) -> str:
    """Write an override for hydra, which tells arguments that a YAML leaves at their default."""
    line = str(override.input_line)
    if override.key_or_group in groups:
        return line.lstrip("+")
    is_argument = override.key_or_group.startswith(("task.", "logger.", "algorithm."))
    return "++" + line.lstrip("+") if is_argument else line


def _compose_base(program: str, chosen: Mapping[str, str], *, places: Sequence[str]) -> DictConfig:
    """Compose what is chosen of the groups, and refuse files that cannot be."""
    lines = [*places, *(f"{group}={value}" for group, value in chosen.items())]
    base = with_defaults(program, compose_config(program, lines))
    for group in list_program_groups(program):
        try:
            if group != "preset":
                check_object(base, group)
        except ConfigError as error:
            _check_preset(program, base, chosen, lines)
            own = compose_config(program, lines, with_hydra=True).hydra.runtime.choices
            files = [f"{one}/{own[one]}.yaml" for one in (group, "preset") if own.get(one)]
            raise ConfigError(f"{error} It is set up by {' and '.join(files)}.") from error
    return base


def _check_preset(
    program: str, base: DictConfig, chosen: Mapping[str, str], lines: Sequence[str]
) -> None:
    """Refuse a preset that sets what only the task has that it is made for."""
    unfit = find_unfit(base.task, "task")
    if unfit is None or "task" not in chosen:
        return
    others = [line for line in lines if not line.startswith("task=")]
    alone = compose_config(program, others, with_hydra=True)
    own = alone.hydra.runtime.choices
    if OmegaConf.select(alone, unfit) is None or find_unfit(alone.task, "task") is not None:
        return
    raise ConfigError(
        f"preset={own.preset}: is for task={own.task}, and task={chosen['task']} takes no "
        f"{unfit}; take another preset, or task={own.task}"
    )


def _find_own_task(program: str, overrides: Sequence[Override]) -> Any:
    """Return the task of the run or checkpoint that is given, or None if another one is chosen."""
    given = {override.key_or_group: override for override in overrides}
    known = {entry.name for entry in fields(SCHEMAS[program])}
    fish = [name for name in ("run", "checkpoint", "policy") if name in known & set(given)]
    if len(fish) != 1 or "policy" in fish or {"task", "preset"} & set(given):
        return None
    from fishrl.training.checkpoint import read_metadata  # slow, as it brings torchrl

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
    return to_settings(program, compose_config(program, check_overrides(program, arguments)))


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


def compose_config(
    program: str, overrides: Sequence[str], *, with_hydra: bool = False
) -> DictConfig:
    """Let hydra compose a checked command line.

    Args:
        program: train, evaluate, view or train_lateral_line.
        overrides: of the command line; options that begin with ``-`` are left out.
        with_hydra: keep what hydra says of itself, such as what is chosen of each group.

    Raises:
        ConfigError: for what cannot be composed.
    """
    overrides = [o for o in overrides if not o.startswith("-")]
    try:
        with initialize_config_dir(str(CONF), version_base="1.3"):
            return compose(program, list(overrides), return_hydra_config=with_hydra)
    except (HydraException, OmegaConfBaseException, YAMLError) as error:
        raise _plain(error) from error


#: How hydra names the file whose settings do not fit.
_FILE = re.compile(r"In '(.+/.+)': \w+ raised while composing")


def _plain(error: Exception) -> ConfigError:
    """Say in one line what hydra and omegaconf say in several."""
    cause = error.__cause__ if isinstance(error.__cause__, OmegaConfBaseException) else error
    lines = [line.strip() for line in str(cause).splitlines() if line.strip()]
    key = getattr(cause, "full_key", None)
    file = _FILE.match(lines[0])
    if file is not None and len(lines) > 1:
        key = next((line[10:] for line in lines if line.startswith("full_key: ")), None)
        lines = lines[1:]
    place = f"{file[1]}.yaml: " if file else ""
    if key == "preset" and "DictConfig" in lines[0]:
        return ConfigError(
            f"{place}{key}: is a name; the file of a preset begins with the line "
            "# @package _global_"
        )
    if key and lines[0].startswith("Key "):
        known = [entry.name for entry in fields(TrainConfig)]
        return ConfigError(f"{place}there is no {key!r}.{nearest(key, known)}")
    return ConfigError(f"{place}{key}: {lines[0]}" if key else place + " ".join(lines))
