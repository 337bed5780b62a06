"""Where the configuration lies: this repository's, and folders of a user's own."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import yaml  # type: ignore[import-untyped]
from hydra import initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.core.object_type import ObjectType
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import OverrideParseException

from experiments.settings import ConfigError

CONF = Path(__file__).parent / "conf"
SEARCH_PATH = "hydra.searchpath"
#: Options of hydra that take the next word as their value.
VALUED = ("--config-name", "-cn", "--config-path", "-cp", "--package", "-p", "--experimental-rerun")
FOLDER = ("--config-dir", "-cd")


def split_arguments(arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    """Tell options of hydra from settings.

    Folders of configuration, given as ``--config-dir <folder>`` or ``hydra.searchpath=[...]``,
    become one setting of hydra's search path, which every command line and ``compose`` understand.

    Args:
        arguments: the command line.

    Returns:
        The options (``--multirun``, ``hydra.x=y``), with their values; and everything else.

    Raises:
        ConfigError: if a folder is not there, or the search path no list.
    """
    options: list[str] = []
    settings: list[str] = []
    places: list[str] = []
    words = iter(arguments)
    for word in words:
        name, has_value, value = word.partition("=")
        if name in FOLDER:
            places.append(_as_place(value if has_value else next(words, "")))
        elif name in VALUED and not has_value:
            options += [word, next(words, "")]
        elif name.lstrip("+") == SEARCH_PATH:
            places += _read_places(word)
        elif word.startswith("-") or word.lstrip("+~").startswith(("hydra.", "hydra/")):
            options.append(word)
        else:
            settings.append(word)
    if places:
        options.append(f"{SEARCH_PATH}=[{','.join(places)}]")
    return options, settings


def list_groups(options: Sequence[str] = ()) -> dict[str, list[str]]:
    """List the config groups and what there is to choose in each, wherever it lies.

    Args:
        options: as ``split_arguments`` returns them.
    """
    overrides = select_search_path(options)
    with initialize_config_dir(str(CONF), version_base="1.3"):
        loader = GlobalHydra.instance().config_loader()

        def list_(group: str, kind: ObjectType) -> list[str]:
            return sorted(loader.get_group_options(group, kind, None, overrides))

        groups = [group for group in list_("", ObjectType.GROUP) if group != "hydra"]
        return {group: list_(group, ObjectType.CONFIG) for group in groups}


def list_program_groups(program: str) -> list[str]:
    """List the config groups that a program takes, in the order of its YAML.

    Args:
        program: train, evaluate, view or train_lateral_line.
    """
    defaults = yaml.safe_load((CONF / f"{program}.yaml").read_text(encoding="utf-8"))["defaults"]
    names = [name for entry in defaults if isinstance(entry, dict) for name in entry]
    return [name for name in names if not name.startswith("override ")]


def select_search_path(options: Sequence[str]) -> list[str]:
    """Return the search path among options, as an override for hydra, or nothing."""
    return [option for option in options if option.startswith(f"{SEARCH_PATH}=")]


def _as_place(folder: str) -> str:
    path = Path(folder).expanduser().resolve()
    if not folder or not path.is_dir():
        raise ConfigError(
            f"--config-dir {folder}: there is no such folder; give one that holds "
            "task/<name>.yaml or preset/<name>.yaml"
        )
    return f"'file://{path}'"


def _read_places(argument: str) -> list[str]:
    """Read what was given for the search path; paths without a scheme are folders here."""
    try:
        (override,) = OverridesParser.create().parse_overrides([argument])
    except OverrideParseException as error:
        raise ConfigError(f"{argument}: write {SEARCH_PATH}=[file://<folder>]") from error
    value = override.value()
    if not isinstance(value, list):
        raise ConfigError(f"{argument}: write {SEARCH_PATH}=[file://<folder>]")
    return [f"'{place}'" if "://" in str(place) else _as_place(str(place)) for place in value]
