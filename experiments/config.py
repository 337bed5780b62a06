"""Settings of the programs by name."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from typing import Any

from experiments.configuration import CONF, build, to_plain

__all__ = ["CONF", "build", "load_config", "to_plain"]


def load_config(program: str, arguments: Sequence[str] = ()) -> Any:
    """Return the settings of a command line of a program."""
    return import_module(f"experiments.{program}").main.read(arguments)


def resumed_settings(folder: str, arguments: Sequence[str] = ()) -> Any:
    """Return the settings with which a run goes on."""
    return load_config("train", [f"resume='{folder}'", *arguments])
