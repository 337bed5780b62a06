"""What there is to measure, by name."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from experiments.benchmarks import (
    compiling,
    coupled,
    cuda_code,
    environment,
    gpu,
    memory,
    profile,
    scaling,
    solver,
    training,
)
from experiments.benchmarks.entry import Settings, Team
from experiments.benchmarks.peers import teams as peers


@dataclass(frozen=True, kw_only=True)
class Group:
    """Things that belong together.

    Args:
        list_teams: returns what takes part in a contest.
        is_long: whether its bursts take seconds; such groups have rounds of their own.
        run: measures beside the contests, and returns numbers and words.
    """

    list_teams: Callable[[Settings], list[Team]] | None = None
    is_long: bool = False
    run: Callable[[Settings], dict[str, Any]] | None = None


GROUPS: dict[str, Group] = {
    "solver": Group(list_teams=solver.list_teams),
    "coupled": Group(list_teams=coupled.list_teams),
    "peers": Group(list_teams=peers.list_teams),
    "gpu": Group(list_teams=gpu.list_teams),
    "scaling": Group(list_teams=scaling.list_teams),
    "env": Group(list_teams=environment.list_teams, is_long=True),
    "train": Group(list_teams=training.list_teams, is_long=True),
    "profile": Group(run=profile.run),
    "compile": Group(run=compiling.run),
    "memory": Group(run=memory.run),
    "cuda": Group(run=cuda_code.run),
}


def choose_groups(names: Sequence[str]) -> list[str]:
    """Return the groups called so in the order of ``GROUPS``, or all if no name is given.

    Raises:
        ValueError: if there is no group of a name.
    """
    for name in names:
        if name not in GROUPS:
            near = difflib.get_close_matches(name.lower(), GROUPS, n=1, cutoff=0.4)
            hint = f" Did you mean {near[0]}?" if near else ""
            raise ValueError(f"no group '{name}'.{hint} The groups are: {', '.join(GROUPS)}")
    return [name for name in GROUPS if name in names or not names]
