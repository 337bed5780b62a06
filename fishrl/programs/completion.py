"""Tab completion, which hydra does: ``eval "$(fishrl -sc install=bash)"``, or zsh, or fish.

The shell asks with ``fishrl -sc query=bash`` and the line so far in ``COMP_LINE``.
"""

import os
import shlex
import sys
from collections.abc import Collection
from importlib import import_module

from hydra.core.config_store import ConfigStore
from omegaconf import DictConfig

from fishrl.programs.configuration import parse, run_hydra, split_options
from fishrl.settings import REQUIRED, to_plain


def answer(programs: Collection[str]) -> None:
    """Install or uninstall completion, or complete, as the command line of this process says."""
    asked = sys.argv[1:]
    line = os.environ.get("COMP_LINE", "")
    words = [*line.split(), ""] if line.endswith(" ") else line.split()
    if not asked[-1].startswith("query="):
        return run_hydra(_do_nothing, None, asked)
    if len(words) < 3 or words[1] not in programs:
        print(*[name for name in programs if len(words) == 2 and name.startswith(words[1])])
        return None
    os.environ["COMP_LINE"] = f"{words[0]} {words[-1]}"
    try:
        before = shlex.split(" ".join(words[2:-1]))
        options = split_options(before)
        asked += ["--config-dir", options.config_dir] if options.config_dir else []
        if "=" in words[-1]:  # the choice of a group, which no program need be imported for
            return run_hydra(_do_nothing, None, asked)
        swept = {each.input_line for each in parse(options.overrides) if each.is_sweep_override()}
        program = import_module(f"fishrl.programs.{words[1].replace('-', '_')}").main
        defaults = program.list_defaults([word for word in before if word not in swept])
        node = {key: None if v is REQUIRED else to_plain(v) for key, v in defaults.items()}
    except (AttributeError, ValueError):  # of argparse, or a mistake in the line
        return None
    ConfigStore.instance().store(name="completed", node=node)
    return run_hydra(_do_nothing, "completed", asked)


def _do_nothing(config: DictConfig) -> None: ...
