"""Versions of tasks: settings, held-out starts and measure, frozen by checksums.

A version ``station-v1`` is a task of ``fishrl.presets`` and an entry of ``versions.json``. The
starts of its splits follow from ``draws.json``, uniform random numbers made by a hash of the
split's name, which no seed of a training or an evaluation gives.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor

from fishrl.envs import AbstractTask, make_task
from fishrl.settings import checked, describe, flatten, unknown

FOLDER = Path(__file__).parent
#: Splits, and how many starts each has.
SPLITS = {"validation": 32, "test": 96}
#: Settings that a policy may choose: what it remembers, what its critics saw, and a cache.
FREE = (
    "num_stacked",
    "critic_observes",
    "critic_num_stacked",
    "critic_reads_stack",
    "stream.wake_folder",
)


@dataclass(frozen=True, kw_only=True)
class Version:
    """A frozen task."""

    name: str  #: such as ``station-v1``
    measure: str  #: metric that counts, see ``Episodes.metrics``
    controller: str  #: baseline whose score is 1; random actions have 0
    held_out: Mapping[str, Any]  #: settings that differ in validation and test
    settings: str  #: checksum of the settings of the task
    starts: Mapping[str, str]  #: checksums of the starts of each split
    #: version with the same flows and starts, other senses: its random actions and controller count
    references: str | None = None

    @property
    def task(self) -> AbstractTask:
        """The task that policies are trained in."""
        return make_task(self.name)

    def hold_out(
        self, split: str, *, task: AbstractTask | None = None
    ) -> tuple[AbstractTask, TensorDictBase]:
        """Return task and starts ``[E]`` of a split; ``task`` has what is ``FREE``.

        Raises:
            ValueError: for an unknown split, and where settings or starts are not as frozen.
        """
        if split not in SPLITS:
            raise unknown(split, list(SPLITS))
        self._check("settings", sum_settings(self.task), self.settings)
        task = replace(task or self.task, **self.held_out)
        starts = task.starts_from(read_draws(split)[:, : task.num_draws])
        task.check_starts(starts)
        self._check(f"starts of {split}", sum_starts(starts), self.starts[split])
        return task, starts

    def _check(self, what: str, found: str, wanted: str) -> None:
        if found != wanted:
            raise ValueError(
                f"{self.name}: its {what} are not those that were frozen (checksum {found}, not "
                f"{wanted}): use the fishrl of its scores, or make a new version"
            )


def list_versions() -> list[str]:
    """List the names of the frozen tasks."""
    return sorted(_read_versions())


@checked
def find_version(name: str) -> Version:
    """Return a frozen task; ValueError for an unknown name, with the nearest one."""
    if name not in (known := _read_versions()):
        raise unknown(name, sorted(known))
    return Version(name=name, **known[name])


@checked
def identify(task: AbstractTask) -> Version:
    """Return the version of a task, which may differ from it in what is ``FREE``.

    Raises:
        ValueError: if there is none, with what differs from the nearest.
    """
    own = sum_settings(task)
    for name, entry in _read_versions().items():
        if entry["settings"] == own:
            return find_version(name)
    found = {name: compare(task, make_task(name)) for name in list_versions()}
    name, keys = min(found.items(), key=lambda item: len(item[1]))
    if not keys:  # what was frozen has changed
        find_version(name).hold_out("test")
    raise ValueError(
        f"task: is none of the frozen ones, {', '.join(found)}; it differs from {name} in "
        f"{', '.join(keys[:5])}: leave that as it is"
    )


@checked
def compare(task: AbstractTask, frozen: AbstractTask) -> list[str]:
    """Return the dotted keys of settings in which two tasks differ, but for those ``FREE``."""
    own, other = (flatten(describe(each)) for each in (task, frozen))
    keys = own.keys() | other.keys()
    return sorted(key for key in keys if key not in FREE and own.get(key) != other.get(key))


@cache
def _read_versions() -> dict[str, dict[str, Any]]:
    versions: dict[str, dict[str, Any]] = json.loads((FOLDER / "versions.json").read_text())
    return versions


def read_draws(split: str) -> Tensor:
    """Return the stored random numbers ``[E, 12]`` of a split, float64 in [0, 1)."""
    draws = json.loads((FOLDER / "draws.json").read_text())[split]
    return torch.tensor(draws, dtype=torch.float64)


def sum_settings(task: AbstractTask) -> str:
    """Return the checksum of all settings of a task that are not ``FREE``."""
    flat = flatten(describe(task))
    return _sum({name: value for name, value in flat.items() if name not in FREE})


def sum_starts(starts: TensorDictBase) -> str:
    """Return the checksum of starts ``[E]``, numbers to nine digits."""
    rows = {
        str(name): [f"{float(x):.9g}" for x in values.reshape(-1)]
        for name, values in starts.items()
    }
    return _sum(rows)


def _sum(plain: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(plain, sort_keys=True).encode()).hexdigest()[:16]
