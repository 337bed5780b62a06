"""Tab completion, which hydra does: ``eval "$(fishrl -sc install=bash)"``, or zsh, or fish.

The shell asks with ``fishrl -sc query=bash`` and the line so far in ``COMP_LINE``.
"""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Collection
from importlib import import_module

import hydra
from hydra.core.config_store import ConfigStore
from omegaconf import DictConfig, OmegaConf

from fishrl.programs.configuration import CONF, parse, split_options


def answer(programs: Collection[str]) -> None:
    """Do what the command line of this process asks: install, uninstall or complete."""
    line = os.environ.get("COMP_LINE", "")
    words = [*line.split(), ""] if line.endswith(" ") else line.split()
    if not sys.argv[-1].startswith("query="):
        return _run_hydra()
    if len(words) < 3 or words[1] not in programs:
        print(*[name for name in programs if len(words) == 2 and name.startswith(words[1])])
        return None
    os.environ["COMP_LINE"] = f"{words[0]} {words[-1]}"
    before = shlex.split(" ".join(words[2:-1]))
    try:
        folder = split_options(before).config_dir
    except ValueError:
        return None
    sys.argv += ["--config-dir", folder] if folder else []
    if "=" in words[-1]:  # the choice of a group, which no program need be imported for
        return _run_hydra()
    program = import_module(f"fishrl.programs.{words[1].replace('-', '_')}").main
    try:
        options = split_options(before)
        swept = {each.input_line for each in parse(options.overrides) if each.is_sweep_override()}
        line = [word for word in before if word not in {*swept, "-m", "--multirun"}]
        node = OmegaConf.to_container(program.command_line.compose(line))
    except (AttributeError, ValueError):  # of argparse, or a mistake in the line
        return None
    ConfigStore.instance().store(name=words[1], node=node)
    return _run_hydra(words[1])


def _run_hydra(name: str | None = None) -> None:
    hydra.main(version_base="1.3", config_path=str(CONF), config_name=name)(_do_nothing)()


def _do_nothing(config: DictConfig) -> None: ...
