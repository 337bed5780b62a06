"""Validation: what is run, cached, checked and reported."""

import inspect
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from math import inf, nan
from pathlib import Path

import pytest

from experiments import validate as program
from experiments.validate import CASES
from experiments.validation import cavity, runner
from experiments.validation.case import Check, Job, Runs
from experiments.validation.plots import fit_order
from experiments.validation.report import read_results, render, render_case
from experiments.validation.runner import Outcome, fingerprint, run_cases, strip_readers
from tests.experiments import toy_cases
from tests.experiments.toy_cases import make_squares

ROOT = Path(__file__).parents[2]


def _read_log(tmp_path: Path) -> list[str]:
    return sorted((tmp_path / "log").read_text().split())


@pytest.fixture
def threads(monkeypatch: pytest.MonkeyPatch) -> None:
    """Run cases in threads, which begin sooner than processes."""
    monkeypatch.setattr(runner, "_open_pool", ThreadPoolExecutor)


def _run(tmp_path: Path, *, is_fresh: bool = False, **settings: object) -> Outcome:
    case = make_squares(log=tmp_path / "log", **settings)  # type: ignore[arg-type]
    (outcome,) = run_cases([case], folder=tmp_path / "results", is_fresh=is_fresh)
    return outcome


@pytest.mark.usefixtures("threads")
def test_cached_results_are_read_unless_arguments_change_or_fresh(tmp_path: Path) -> None:
    _run(tmp_path, values=(2.0, 3.0))
    outcome = _run(tmp_path, values=(2.0, 4.0))
    assert _read_log(tmp_path) == ["2", "3", "4"]
    log = str(tmp_path / "log")
    assert outcome.runs.read("square", "value", log=log) == {2.0: 4.0, 4.0: 16.0}
    _run(tmp_path, values=(2.0,), is_fresh=True)
    assert _read_log(tmp_path) == ["2", "2", "3", "4"]


def test_choice_without_a_quick_run_is_refused() -> None:
    with pytest.raises(ValueError, match=r"cases = \['gaits'\]: quick=true has .*swimmer"):
        program.main.read(["quick=true", "cases=[gaits]"])


def test_failed_jobs_are_misses_and_others_continue(tmp_path: Path) -> None:
    others = [(getattr(toy_cases, name), {}) for name in ("blow_up", "die", "return_a_path")]
    outcome = _run(tmp_path, others=others)
    assert len(outcome.runs.finished) == 2
    notes = {check.quantity: check.note for check in outcome.checks}
    assert "the flow diverged" in notes["run blow_up()"]
    assert "BrokenProcessPool" in notes["run die()"]
    assert "TypeError" in notes["run return_a_path()"]
    assert {check.verdict for check in outcome.checks} == {"MISSED"}


def test_stopped_run_keeps_finished_jobs(tmp_path: Path) -> None:
    script = (
        "if __name__ == '__main__':\n"  # not in the processes that it starts
        "    import signal, sys; from pathlib import Path\n"
        "    from experiments import validate\n"
        "    from tests.experiments.toy_cases import make_squares, stop_parent\n"
        "    log = Path(sys.argv[1], 'log')\n"
        "    stop = (stop_parent, dict(number=signal.SIGTERM.value, log=str(log)))\n"
        "    validate.CASES = (make_squares(log=log, others=[stop]),)\n"
        "    validate.main(['jobs=1', f'folder={log.parent}/results'])\n"
    )
    (tmp_path / "stopped.py").write_text(script)
    command = [sys.executable, str(tmp_path / "stopped.py"), str(tmp_path)]
    env = {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, env=env, capture_output=True, text=True, timeout=120)
    assert done.returncode == 128 + signal.SIGTERM, done.stderr
    assert "leaked" not in done.stderr  # semaphores of the processes that it ended
    kept = {path.stem for path in (tmp_path / "results").glob("*/*.json")}
    jobs = make_squares(log=tmp_path / "log").jobs
    assert kept == {fingerprint(job) for job in jobs}  # by keys that are equal in every process


def run_program(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *arguments: str, **settings: object
) -> tuple[int | str | None, Path]:
    """Run the program with toy cases; return its exit status and the folder of the docs."""
    case = make_squares(log=tmp_path / "log", **settings)  # type: ignore[arg-type]
    monkeypatch.setattr(program, "CASES", (case,))
    status: int | str | None = 0
    try:
        program.main(["jobs=1", f"folder={tmp_path}/results", f"docs={tmp_path}/docs", *arguments])
    except SystemExit as end:
        status = end.code
    return status, tmp_path / "docs"


@pytest.mark.usefixtures("threads")
def test_full_run_fails_with_missed_goal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    status, docs = run_program(tmp_path, monkeypatch, reference=8.0, note="Nine is not eight.")
    assert status == 1
    row = "| square of the last | 9 | 8 ± 1 % | **MISSED**, 12 % |"
    page = (docs / "validation.md").read_text()
    assert f"| [Squares](validation/squares.json) {row}" in page
    assert "- [Squares](validation/squares.json), *square of the last*: Nine is not" in page
    ((case, stored),) = read_results(program.CASES, docs)
    assert (stored["checks"][0]["error"], stored["checks"][0]["verdict"]) == (0.125, "MISSED")
    page = render_case(case, stored)
    row = "| square of the last | 9 | 8 (arithmetic) | 12 % | 1 % | **MISSED** | x = 3 |"
    for part in (row, "| quantity | x = 2 | x = 3 |", "(../figures/validation/squares.png)"):
        assert part in page
    assert (docs / "figures" / "validation" / "squares.png").stat().st_size > 1000


@pytest.mark.usefixtures("threads")
def test_partial_runs_leave_docs_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for argument, reference in (("quick=true", 4.0), ("cases=[squares]", 9.0)):
        status, docs = run_program(tmp_path, monkeypatch, argument, reference=reference)
        assert status == 0
        assert not docs.exists()
        assert (tmp_path / "results" / "validation.md").is_file()


@pytest.mark.parametrize(
    ("ours", "reference", "tolerance", "verdict"),
    [
        (1.009, 1.0, 0.01, "pass"),
        (-1.011, -1.0, 0.01, "MISSED"),
        (1.5, (1.0, 2.0), None, "pass"),
        (2.1, (1.0, 2.0), None, "MISSED"),
        (2.1, (1.0, 2.0), 0.1, "pass"),
        (1.94, (1.95, inf), None, "MISSED"),
        (7.0, 1.0, None, "recorded"),
        (7.0, None, None, "recorded"),
        (nan, (0.0, 2.0), None, "MISSED"),
        (nan, None, None, "MISSED"),
    ],
)
def test_verdict_follows_reference_and_tolerance(
    ours: float,
    reference: float | tuple[float, float] | None,
    tolerance: float | None,
    verdict: str,
) -> None:
    assert Check("a", ours, reference, tolerance=tolerance).verdict == verdict


def _toy(*, size: int, speed: float = 1.0) -> dict[str, float]:
    return {"drag": size * speed}


def test_runs_are_found_by_arguments_and_defaults() -> None:
    arguments = [{"size": 1}, {"size": 2, "speed": 1.0}, {"size": 2, "speed": 3.0}]
    runs = Runs([(Job(_toy, a), _toy(**a)) for a in arguments])  # type: ignore[arg-type]
    assert runs.read("drag", "size") == {1: 1.0, 2: 2.0}
    assert runs.read("drag", "speed", size=2) == {1.0: 2.0, 3.0: 6.0}
    assert runs.get(size=2, speed=3.0) == {"drag": 6.0}
    with pytest.raises(KeyError):
        runs.get(size=1, speed=3.0)


@pytest.mark.parametrize(
    ("old", "new", "counts"),
    [("STEADY = 1e-5", "STEADY = 1e-4", True), ("(row[0], ", "(row[1], ", False)],
)
def test_source_of_readers_does_not_count(old: str, new: str, counts: bool) -> None:
    source = inspect.getsource(cavity)
    assert old in source
    assert (strip_readers(source) != strip_readers(source.replace(old, new))) is counts


def test_fingerprints_of_all_runs_differ() -> None:
    keys = [fingerprint(job) for case in CASES for job in case.jobs]
    assert len(set(keys)) == len(keys)


def test_committed_page_follows_from_stored_results() -> None:
    docs = ROOT / "docs"
    results = read_results(CASES, docs)
    assert (docs / "validation.md").read_text() == render(results, "make validate")
    for case, stored in results:
        assert (docs / "figures" / "validation" / f"{case.name}.png").is_file()
        for row in stored["checks"]:
            if row["error"] is not None and row["tolerance"] is not None:
                assert (row["error"] <= row["tolerance"]) is (row["verdict"] == "pass"), row


def test_order_of_a_known_curve() -> None:
    assert fit_order({n: 3.0 * n**-2.0 for n in (8, 16, 64)}) == pytest.approx(2.0)
