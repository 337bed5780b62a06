"""The benchmark's protocol: processes, turns, bursts, and what is left out."""

from pathlib import Path

import pytest

from experiments.benchmarks import contest
from experiments.benchmarks.contest import (
    Entry,
    Settings,
    Team,
    find_length,
    run_contest,
    time_burst,
)
from tests.experiments.benchmarks import toy_teams

SETTINGS = Settings(rounds=3, threads=1)


class Clock:
    """A clock that a step moves on."""

    def __init__(self) -> None:
        self.now = 0.0

    def entry(self, seconds: float, **fields: int) -> Entry:
        def advance(num_steps: int) -> None:
            self.now += num_steps * seconds

        return Entry(label="x", name="x", advance=advance, **fields)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(contest.time, "perf_counter", lambda: clock.now)
    return clock


@pytest.fixture
def diary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("TOY_DIARY", str(tmp_path / "diary"))
    return tmp_path / "diary"


def test_processes_take_turns_and_rows_keep_what_they_found(diary: Path) -> None:
    teams = [Team("toys", toy_teams.make_pair, code=code) for code in ("one", "two")]
    rows, skipped = run_contest(teams, SETTINGS)
    processes = [line.split()[0] for line in diary.read_text().splitlines()]
    one, two = processes[:2]  # each runs its cases once before the rounds
    assert one != two
    assert processes == [one, two] * (SETTINGS.rounds + 1)
    assert [(row.code, row.label) for row in rows] == [
        ("one", "pair/a"), ("one", "pair/b"), ("two", "pair/a"), ("two", "pair/b"),
    ]  # fmt: skip
    assert all(len(row.seconds) == SETTINGS.rounds for row in rows)
    assert (rows[0].num_steps, rows[0].facts, rows[1].extras) == (2, {"slip": 0.1}, {})
    assert rows[0].extras == {"share": [0.25] * SETTINGS.rounds}
    assert not skipped


def test_a_team_that_is_absent_or_fails_is_left_out_and_the_others_go_on(diary: Path) -> None:
    reasons = {
        toy_teams.miss_a_package: "No module named 'peer'",
        toy_teams.fail_at_once: "RuntimeError: the shear wave",
        toy_teams.fail_in_a_burst: "ZeroDivisionError",
        toy_teams.die: "BrokenProcessPool",
        toy_teams.die_between_bursts: "BrokenProcessPool",
    }
    teams = [Team("toys", make, code="bad") for make in reasons]
    rows, skipped = run_contest([*teams, Team("toys", toy_teams.make_pair)], SETTINGS)
    assert [row.label for row in rows] == ["pair/a", "pair/b"]
    assert [each.has_failed for each in skipped] == [False, True, True, True, True]
    for each, why in zip(skipped, reasons.values(), strict=True):
        assert why in each.why


def test_a_number_that_is_measured_once_has_no_bursts() -> None:
    (row,), _ = run_contest([Team("compile", toy_teams.make_number)], SETTINGS)
    assert (row.facts, row.seconds) == ({"seconds": 0.5}, [])


@pytest.mark.parametrize(("seconds", "multiple", "expected"), [(0.01, 2, 4), (0.3, 2, 2)])
def test_a_burst_has_as_many_steps_as_fill_it(
    clock: Clock, seconds: float, multiple: int, expected: int
) -> None:
    assert find_length(clock.entry(seconds, multiple=multiple), 0.04) == expected


def test_a_burst_begins_with_steps_that_are_not_timed() -> None:
    counts: list[int] = []
    time_burst(Entry(label="x", name="x", advance=counts.append, multiple=2), 20)
    assert counts == [4, 20]


def test_preparing_a_burst_is_not_timed(clock: Clock) -> None:
    def prepare() -> None:
        clock.now += 5.0

    entry = clock.entry(0.5)
    entry.prepare = prepare
    assert time_burst(entry, 4) == (0.5, {})


def test_settings_have_bounds() -> None:
    with pytest.raises(ValueError, match="rounds = 1: must be at least 2"):
        Settings(rounds=1)
    with pytest.raises(ValueError, match="a multiple of 4"):
        Settings(body_length=102)
