"""The benchmark's protocol: processes, turns, bursts, and what is left out."""

from pathlib import Path

import pytest

from experiments.benchmarks import comparison
from experiments.benchmarks.comparison import (
    BenchmarkSettings,
    Case,
    Job,
    compare_codes,
    find_length,
    time_burst,
)
from tests.experiments.benchmarks import toy_jobs

SETTINGS = BenchmarkSettings(rounds=3, threads=1)


class Clock:
    """A clock that a step moves on."""

    def __init__(self) -> None:
        self.now = 0.0

    def make_case(self, seconds: float, **fields: int) -> Case:
        def advance(num_steps: int) -> None:
            self.now += num_steps * seconds

        return Case(label="x", name="x", advance=advance, **fields)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(comparison.time, "perf_counter", lambda: clock.now)
    return clock


@pytest.fixture
def log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("TOY_LOG", str(tmp_path / "log"))
    return tmp_path / "log"


def test_processes_take_turns_and_rows_keep_what_they_found(log: Path) -> None:
    jobs = [Job("toys", toy_jobs.make_pair, code=code) for code in ("one", "two")]
    rows, skipped = compare_codes([*jobs, Job("compile", toy_jobs.make_number)], SETTINGS)
    processes = [line.split()[0] for line in log.read_text().splitlines()]
    one, two = processes[:2]  # each runs its cases once before the rounds
    assert one != two
    assert processes == [one, two] * (SETTINGS.rounds + 1)
    assert [(row.code, row.label) for row in rows[:-1]] == [
        ("one", "pair/a"), ("one", "pair/b"), ("two", "pair/a"), ("two", "pair/b"),
    ]  # fmt: skip
    assert all(len(row.seconds) == SETTINGS.rounds for row in rows[:-1])
    assert (rows[0].num_steps, rows[0].facts, rows[1].extras) == (2, {"slip": 0.1}, {})
    assert rows[0].extras == {"share": [0.25] * SETTINGS.rounds}
    assert (rows[-1].facts, rows[-1].seconds) == ({"seconds": 0.5}, [])  # measured once
    assert not skipped


def test_a_job_that_is_absent_or_fails_is_left_out_and_the_others_go_on(log: Path) -> None:
    reasons = {
        toy_jobs.miss_a_package: "No module named 'peer'",
        toy_jobs.fail_at_once: "RuntimeError: the shear wave",
        toy_jobs.fail_in_a_burst: "ZeroDivisionError",
        toy_jobs.die_between_bursts: "BrokenProcessPool",
    }
    jobs = [Job("toys", make, code="bad") for make in reasons]
    rows, skipped = compare_codes([*jobs, Job("toys", toy_jobs.make_pair)], SETTINGS)
    assert [row.label for row in rows] == ["pair/a", "pair/b"]
    assert [each.has_failed for each in skipped] == [False, True, True, True]
    for each, why in zip(skipped, reasons.values(), strict=True):
        assert why in each.why


@pytest.mark.parametrize(("seconds", "multiple", "expected"), [(0.01, 2, 4), (0.3, 2, 2)])
def test_a_burst_has_as_many_steps_as_fill_it(
    clock: Clock, seconds: float, multiple: int, expected: int
) -> None:
    assert find_length(clock.make_case(seconds, multiple=multiple), 0.04) == expected


def test_warming_up_and_preparing_a_burst_are_not_timed(clock: Clock) -> None:
    counts: list[int] = []
    time_burst(Case(label="x", name="x", advance=counts.append, multiple=2), 20)
    assert counts == [4, 20]

    def prepare() -> None:
        clock.now += 5.0

    case = clock.make_case(0.5)
    case.prepare = prepare
    assert time_burst(case, 4) == (0.5, {})
