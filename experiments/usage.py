"""What ``--help`` says: what a program takes, its defaults, and where more stands about it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import Any

import yaml  # type: ignore[import-untyped]
from omegaconf import OmegaConf

from experiments.command_line import show_command
from experiments.config import SCHEMAS, check_overrides, compose_config, with_defaults
from experiments.search_path import list_groups, list_program_groups, split_arguments

TEXT = """{summary}

Groups, group=name chooses:
{groups}

Settings, key=value changes one, a dot goes into an object (task.body_length=64):
{settings}
What each of them means: `make docs`, then build/docs/configuration.html; or
{commands}"""


class _Dumper(yaml.SafeDumper):  # type: ignore[misc]
    """Writes lists into one line."""


_Dumper.add_representer(
    list, lambda dumper, value: dumper.represent_sequence("tag:yaml.org,2002:seq", value, True)
)


def describe_program(program: str, arguments: Sequence[str] = ()) -> str:
    """Say what a program takes, with every plain argument of task, algorithm and logger.

    Args:
        program: train, evaluate, view or train_lateral_line.
        arguments: its command line, whose choices are shown in place of the defaults.

    Raises:
        ConfigError: for a command line that cannot be.
    """
    options, _ = split_arguments(arguments)
    checked = check_overrides(program, arguments)
    config = with_defaults(program, compose_config(program, checked))
    settings: Any = OmegaConf.to_container(config)
    own, known = list_program_groups(program), list_groups(options)
    doc = import_module(f"experiments.{program}").__doc__ or ""
    explained = [f"experiments.settings.{SCHEMAS[program].__name__}"]
    explained += [
        settings[group]["_target_"] for group in own if isinstance(settings.get(group), Mapping)
    ]
    return TEXT.format(
        summary=doc.strip().replace("``", "`"),
        groups="\n".join(f"  {group}: {', '.join(known[group])}" for group in own),
        settings=yaml.dump(settings, Dumper=_Dumper, sort_keys=False, width=100),
        commands="\n".join(f"  {show_command('pydoc', name)}" for name in explained),
    )
