"""What is timed: an entry, and the team of entries that one process holds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

#: Nine populations of four bytes, each read and written once.
BYTES_PER_UPDATE = 72

KERNEL = "kernel"  # the pass over all nodes, and nothing at the edges
PERIODIC = "periodic"  # a whole step, what leaves enters on the other side
WALLS = "with walls"  # a whole step with the boundaries on all four sides
FISH = "with fish"  # the same with a swimming fish in each flow
PROBE = "memory"  # no flow: what the memory does
OTHER = "other"


@dataclass(frozen=True, kw_only=True)
class Entry:
    """One thing that is timed.

    Args:
        label: by which goals and plots find it, one of a kind, such as "large/walls".
        name: what it is, in words.
        advance: run so many steps; numbers that it returns are kept beside the times.
        scope: how much of a step it is: kernel, periodic, with walls, with fish.
        num_nodes: node updates of one step, all flows together; 0 where no flow is advanced.
        working_set: bytes that a step goes through.
        bytes_per_update: that a node update moves if each population is read and written once.
        multiple: the numbers of steps it can run are multiples of this.
        num_steps: of each burst, which then has no warm-up; None finds how many fill a burst.
        prepare: called before each burst, outside the time.
        unit: of what takes time, "step" of a flow or what else.
        facts: numbers and words about it that are known before, such as the slip reached.
    """

    label: str
    name: str
    advance: Callable[[int], dict[str, float] | None]
    scope: str = OTHER
    num_nodes: int = 0
    working_set: int = 0
    bytes_per_update: int = BYTES_PER_UPDATE
    multiple: int = 1
    num_steps: int | None = None
    prepare: Callable[[], object] | None = None
    unit: str = "step"
    facts: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Team:
    """What one process holds.

    Args:
        code: whose it is, such as "fishrl" or "lbmpy".
        group: of the benchmark.
        make: at the top of a module; returns the entries in the process that times them. An
            ImportError means that the code is not there.
        arguments: its keywords.
    """

    code: str
    group: str
    make: Callable[..., Sequence[Entry]]
    arguments: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Settings:
    """What all groups share.

    Args:
        body_length: L of the large case, whose tank is 10 L x 5 L; others have L / 2 and L / 4.
        threads: cores that each code may use.
        rounds: bursts of every entry.
        burst: seconds that a burst should take.
    """

    body_length: int = 100
    threads: int = 1
    rounds: int = 15
    burst: float = 0.03

    def __post_init__(self) -> None:
        """Refuse what cannot be measured."""
        if self.body_length < 80 or self.body_length % 4:
            raise ValueError(
                f"body_length = {self.body_length}: give a multiple of 4, at least 80: the "
                "small case has a fish of a quarter of it, the environment one of half of it"
            )
        if self.rounds < 2:
            raise ValueError(f"rounds = {self.rounds}: quartiles need at least 2")
        if self.threads < 1:
            raise ValueError(f"threads = {self.threads}: give at least 1")
        if self.burst <= 0.0:
            raise ValueError(f"burst = {self.burst} seconds: must be positive")
