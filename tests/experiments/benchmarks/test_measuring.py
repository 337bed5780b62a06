"""The measuring loop: turns, bursts, and what is not timed."""

import pytest

from experiments.benchmarks import measuring
from experiments.benchmarks.measuring import (
    BenchmarkSettings,
    Case,
    find_length,
    measure,
)


class Clock:
    """A clock that a step moves on."""

    def __init__(self) -> None:
        self.now = 0.0

    def make_case(self, seconds: float) -> Case:
        def advance(num_steps: int) -> None:
            self.now += num_steps * seconds

        return Case(label="x", name="x", advance=advance)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(measuring.time, "perf_counter", lambda: clock.now)
    return clock


def test_cases_take_turns_and_keep_what_was_measured() -> None:
    turns: list[tuple[str, int]] = []

    def make(label: str) -> Case:
        def advance(num_steps: int) -> dict[str, float]:
            turns.append((label, num_steps))
            return {"share": 0.25}

        return Case(label=label, name=label, advance=advance, num_steps=3)

    known = Case(label="known", name="known", num_steps=0, measured={"seconds": [0.5]})
    cases = [make("a"), known, make("b")]
    measure(cases, BenchmarkSettings(rounds=2))
    assert turns == [("a", 3), ("b", 3)] * 3  # once before the rounds
    assert cases[0].measured["share"] == [0.25] * 2
    assert len(cases[0].measured["seconds"]) == 2
    assert known.measured == {"seconds": [0.5]}  # measured before


@pytest.mark.parametrize(("seconds", "expected"), [(0.01, 4), (0.3, 2)])
def test_a_burst_has_as_many_steps_as_fill_it(clock: Clock, seconds: float, expected: int) -> None:
    assert find_length(clock.make_case(seconds), 0.04) == expected
