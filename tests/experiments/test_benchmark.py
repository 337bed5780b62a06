"""The benchmark's protocol: processes, turns, bursts, who is left out; and its command line."""

import json
import sys
from pathlib import Path

import pytest

from experiments import benchmark
from experiments.benchmarks import contest
from experiments.benchmarks.contest import find_length, run_contest
from experiments.benchmarks.entry import Entry, Settings
from experiments.benchmarks.groups import GROUPS, Group, choose_groups
from experiments.benchmarks.machine import read_caches
from tests.experiments import toy_teams
from tests.experiments.toy_teams import make_team, make_walker

SETTINGS = Settings(rounds=3)


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


def test_bursts_go_round_and_the_first_round_does_not_count(tmp_path: Path) -> None:
    diary = str(tmp_path / "diary")
    teams = [make_team(make_walker, name, name=name, diary=diary) for name in ("one", "two")]
    rows, skipped = run_contest(teams, SETTINGS)
    lines = Path(diary).read_text().splitlines()
    assert lines == ["one 2", "two 2"] * (SETTINGS.rounds + 1)
    assert [row.label for row in rows] == ["one/a", "one/b", "two/a", "two/b"]
    assert all(len(row.seconds) == SETTINGS.rounds for row in rows)
    assert not skipped


def test_a_row_keeps_what_its_entry_said_and_what_came_with_the_bursts(tmp_path: Path) -> None:
    team = make_team(make_walker, "one", name="one", diary=str(tmp_path / "diary"))
    row = run_contest([team], SETTINGS)[0][0]
    assert (row.code, row.group, row.num_nodes, row.num_steps) == ("one", "toys", 1000, 2)
    assert row.facts == {"slip": 0.1}
    assert row.extras == {"share": [0.25] * 3}


def test_who_is_absent_or_fails_is_left_out_with_a_word_and_the_others_go_on(
    tmp_path: Path,
) -> None:
    names = ("miss_a_package", "fail_at_once", "fail_later", "die")
    teams = [make_team(getattr(toy_teams, name), name) for name in names]
    walker = make_team(make_walker, "one", name="one", diary=str(tmp_path / "diary"))
    rows, skipped = run_contest([*teams, walker], SETTINGS)
    assert [row.code for row in rows] == ["one", "one"]
    assert [each.code for each in skipped] == list(names)
    for each, word in zip(
        skipped, ("No module named 'peer'", "shear wave", "ZeroDivisionError", "exit status 3"),
        strict=True,
    ):  # fmt: skip
        assert word in each.why
    assert [each.has_failed for each in skipped] == [False, True, True, True]


@pytest.mark.parametrize(("seconds", "multiple", "expected"), [(0.01, 2, 4), (0.3, 2, 2)])
def test_a_burst_has_as_many_steps_as_fill_it(
    clock: Clock, seconds: float, multiple: int, expected: int
) -> None:
    assert find_length(clock.entry(seconds, multiple=multiple), 0.04) == expected


def test_a_burst_begins_with_steps_that_do_not_count(clock: Clock) -> None:
    counts: list[int] = []
    entry = Entry(**vars(clock.entry(0.5, multiple=2)) | {"advance": counts.append})
    contest._time(entry, 20)
    assert counts == [4, 20]


def test_what_is_prepared_before_a_burst_is_not_timed(clock: Clock) -> None:
    def prepare() -> None:
        clock.now += 5.0

    entry = Entry(**vars(clock.entry(0.5)) | {"prepare": prepare})
    assert contest._time(entry, 4) == (0.5, {})


def test_a_process_that_ends_while_others_are_timed_is_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(contest, "_PAUSE", 0.5)  # it is gone when the next burst is asked for
    walker = make_team(make_walker, "one", name="one", diary=str(tmp_path / "diary"))
    rows, (gone,) = run_contest([make_team(toy_teams.die_at_rest, "gone"), walker], SETTINGS)
    assert [row.code for row in rows] == ["one", "one"]
    assert gone.code == "gone"
    assert "exit status 4" in gone.why


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ({"rounds": 1}, "quartiles need at least 2"),
        ({"threads": 0}, "at least 1"),
        ({"burst": 0.0}, "must be positive"),
        ({"body_length": 60}, "at least 80"),
        ({"body_length": 102}, "a multiple of 4"),
    ],
)
def test_settings_that_cannot_be_measured_are_refused(setting: dict[str, int], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        Settings(**setting)


def test_a_misspelt_group_is_told_the_nearest() -> None:
    with pytest.raises(ValueError, match=r"no group 'copled'. Did you mean coupled\?"):
        choose_groups(["copled"])


def test_groups_run_in_their_own_order_and_all_by_default() -> None:
    assert choose_groups(["memory", "solver"]) == ["solver", "memory"]
    assert choose_groups([]) == list(GROUPS)


def test_caches_are_read_as_linux_lists_them(tmp_path: Path) -> None:
    for i, (kind, level, size) in enumerate(
        [("Data", "1", "48K"), ("Instruction", "1", "32K"), ("Unified", "3", "32768K")]
    ):
        folder = tmp_path / f"index{i}"
        folder.mkdir()
        for name, value in (("type", kind), ("level", level), ("size", size)):
            (folder / name).write_text(value + "\n")
    assert read_caches(tmp_path) == {"L1": 48 * 1024, "L3": 32 * 2**20}


def _run(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, *arguments: str, **groups: Group
) -> int | str | None:
    monkeypatch.setenv("TOY_DIARY", str(tmp_path / "diary"))
    for name, group in groups.items():
        monkeypatch.setitem(GROUPS, name, group)
    line = ["benchmark", "--folder", str(tmp_path), "--threads", "1", "--rounds", "2", *arguments]
    monkeypatch.setattr(sys, "argv", line)
    monkeypatch.setattr(benchmark, "list_probes", lambda settings: [])
    with pytest.raises(SystemExit) as ended:
        benchmark.main()
    return ended.value.code


def test_a_run_prints_tables_and_keeps_every_time_as_json(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    solver = Group(list_teams=toy_teams.list_walkers)
    memory = Group(run=lambda settings: {"rows": [{"name": "toy", "bytes_per_node": 40.0}]})
    status = _run(
        monkeypatch, tmp_path, "--groups", "solver", "memory", solver=solver, memory=memory
    )
    assert status == 0
    printed = capsys.readouterr().out
    for word in ("Goals", "memory per node and flow", "40.00 B", "1 threads per code", "torch"):
        assert word in printed
    kept = json.loads((tmp_path / "results.json").read_text())
    assert set(kept) == {"version", "machine", "settings", "rows", "skipped", "studies"}
    assert {"cpu", "cores", "torch", "versions", "caches", "load"} <= set(kept["machine"])
    assert kept["settings"]["groups"] == ["solver", "memory"]
    assert len(kept["rows"][0]["seconds"]) == 2


@pytest.mark.parametrize("is_study", [False, True])
def test_a_failure_of_our_own_ends_with_status_1_and_keeps_the_rest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_study: bool
) -> None:
    def fail(settings: Settings) -> dict[str, object]:
        raise RuntimeError("no compiler")

    failing = Group(run=fail) if is_study else Group(list_teams=toy_teams.list_failures)
    solver = Group(list_teams=toy_teams.list_walkers)
    arguments = ("--groups", "solver", "memory")
    assert _run(monkeypatch, tmp_path, *arguments, solver=solver, memory=failing) == 1
    kept = json.loads((tmp_path / "results.json").read_text())
    assert len(kept["rows"]) == 2
    assert kept["skipped"][0]["has_failed"]


def test_a_wrong_argument_ends_with_a_message(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert "quartiles need" in str(_run(monkeypatch, tmp_path, "--rounds", "1"))
