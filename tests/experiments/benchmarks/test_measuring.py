"""The measuring loop: turns, bursts, and what is not timed."""

from experiments.benchmarks.measuring import (
    BenchmarkSettings,
    Case,
    measure,
)


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
