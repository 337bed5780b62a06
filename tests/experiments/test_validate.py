"""Every case by one command: what is run, kept, judged and shown."""

import json
import subprocess
import sys
from collections.abc import Callable
from math import inf, nan
from pathlib import Path

import pytest

from experiments import validate as program
from experiments.validation.case import Check, Job
from experiments.validation.catalogue import CASES
from experiments.validation.convergence import find_extreme, fit_order
from experiments.validation.fingerprint import fingerprint
from experiments.validation.report import render
from experiments.validation.runner import Outcome, run_cases
from tests.experiments import toy_cases
from tests.experiments.toy_cases import Squares, square

ROOT = Path(__file__).parents[2]


def _diary(tmp_path: Path) -> list[str]:
    return sorted((tmp_path / "diary").read_text().split())


def _run(tmp_path: Path, **settings: object) -> list[Outcome]:
    case = Squares(diary=tmp_path / "diary", **settings)  # type: ignore[arg-type]
    return run_cases([case], folder=tmp_path / "results")


def test_a_known_result_is_read_and_a_changed_argument_runs_again(tmp_path: Path) -> None:
    _run(tmp_path, values=(2.0, 3.0))
    (outcome,) = _run(tmp_path, values=(2.0, 4.0))
    assert _diary(tmp_path) == ["2", "3", "4"]
    assert outcome.results == {"x = 2": {"square": 4.0}, "x = 4": {"square": 16.0}}


def test_fresh_runs_again_what_is_known(tmp_path: Path) -> None:
    for is_fresh in (False, True):
        case = Squares(diary=tmp_path / "diary", values=(2.0,))
        run_cases([case], folder=tmp_path / "results", is_fresh=is_fresh)
    assert _diary(tmp_path) == ["2", "2"]


def test_failed_jobs_are_misses_and_the_others_go_on(tmp_path: Path) -> None:
    others = [(getattr(toy_cases, name), {}) for name in ("blow_up", "die", "return_a_path")]
    (outcome,) = _run(tmp_path, others=others)
    assert set(outcome.results) == {"x = 2", "x = 3"}
    notes = {check.quantity: check.note for check in outcome.checks}
    assert "RuntimeError: the flow diverged" in notes["run blow_up"]
    assert "exit status 3" in notes["run die"]
    assert "not JSON serializable" in notes["run return_a_path"]
    assert {check.verdict for check in outcome.checks} == {"MISSED"}


@pytest.mark.parametrize("name", ["SIGTERM", "SIGINT"])
def test_a_stopped_run_keeps_what_is_finished(tmp_path: Path, name: str) -> None:
    script = (
        "import signal, sys; from pathlib import Path\n"
        # a shell's background jobs begin with SIGINT ignored
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "from experiments.validate import resumable\n"
        "from experiments.validation.runner import run_cases\n"
        "from tests.experiments.toy_cases import Squares, stop_parent\n"
        "if __name__ == '__main__':\n"
        "    diary = Path(sys.argv[1], 'diary')\n"
        f"    stop = (stop_parent, dict(number=signal.{name}.value, diary=str(diary)))\n"
        "    with resumable():\n"
        "        case = Squares(diary=diary, others=[stop])\n"
        "        run_cases([case], folder=diary.parent / 'results')\n"
    )
    (tmp_path / "stopped.py").write_text(script)
    command = [sys.executable, str(tmp_path / "stopped.py"), str(tmp_path)]
    env = {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, env=env, capture_output=True, text=True, timeout=120)
    assert done.returncode == 130, done.stderr
    assert "the same command goes on" in done.stderr
    assert len(list((tmp_path / "results").rglob("*.json"))) == 2


@pytest.fixture
def run_program(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Callable[..., tuple[int | str | None, Path]]:
    """Run the program with toy cases; return its exit status and the folder of the docs."""

    def run(*arguments: str, **settings: object) -> tuple[int | str | None, Path]:
        places = ["--folder", str(tmp_path / "results"), "--docs", str(tmp_path / "docs")]
        monkeypatch.setattr(sys, "argv", ["validate", "--jobs", "1", *places, *arguments])
        with pytest.raises(SystemExit) as end:
            program.main([Squares(diary=tmp_path / "diary", **settings)])  # type: ignore[arg-type]
        return end.value.code, tmp_path / "docs"

    return run


Program = Callable[..., tuple[int | str | None, Path]]


def test_a_full_run_writes_the_page_and_its_figure(run_program: Program) -> None:
    status, docs = run_program()
    page = (docs / "validation.md").read_text()
    assert status == 0
    assert (
        "| squares | square of the last | 9 | 9 (arithmetic) | 0 % | 1 % | pass | x = 3 |" in page
    )
    assert "| squares | square of the first | 4 | – | – | – | recorded | – |" in page
    assert "| quantity | x = 2 | x = 3 | reference |" in page
    assert "1 checks pass, 0 missed, 1 recorded" in page
    assert "cores" in page and "torch" in page
    assert "(figures/validation/squares.png)" in page
    assert (docs / "figures" / "validation" / "squares.png").stat().st_size > 1000


def test_a_missed_bar_is_shown_with_its_reason_and_ends_in_failure(
    run_program: Program, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    status, docs = run_program(reference=8.0, note="nine is not eight.")
    page = (docs / "validation.md").read_text()
    assert status == 1
    assert "| 9 | 8 (arithmetic) | 12 % | 1 % | **MISSED** |" in page
    assert "**MISSED**: square of the last: nine is not eight." in page
    assert "**1 MISSED**" in capsys.readouterr().out
    rows = json.loads((tmp_path / "results" / "validation.json").read_text())
    assert [row["verdict"] for row in rows] == ["MISSED", "recorded"]


def test_a_failed_run_ends_in_failure(run_program: Program) -> None:
    status, docs = run_program(others=[(toy_cases.blow_up, {})])
    assert status == 1
    assert "the run failed: RuntimeError: the flow diverged" in (docs / "validation.md").read_text()


def test_quick_and_chosen_runs_leave_the_docs_alone(run_program: Program, tmp_path: Path) -> None:
    for arguments in (["--quick"], ["--cases", "squares"]):
        _, docs = run_program(*arguments, reference=4.0)
        assert not docs.exists()
        assert (tmp_path / "results" / "validation.md").is_file()


def test_a_case_that_cannot_be_judged_is_a_miss(tmp_path: Path) -> None:
    (outcome,) = _run(tmp_path, values=(), others=[(toy_cases.square_nothing, {})])
    assert [check.verdict for check in outcome.checks] == ["MISSED"]
    assert "IndexError" in outcome.checks[0].note


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--cases", "square"], "no case 'square'. Did you mean squares? The cases are: squares"),
        (["--jobs", "0"], "jobs = 0: at least one process"),
        (["--folder", "/dev/null/here"], "cannot be written"),
    ],
)
def test_bad_input_is_explained(run_program: Program, arguments: list[str], message: str) -> None:
    status, _ = run_program(*arguments)
    assert message in str(status)


def test_two_jobs_of_one_label_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="two jobs of one label"):
        _run(tmp_path, values=(2.0, 2.0))


def test_jobs_that_no_other_process_could_run_are_refused() -> None:
    with pytest.raises(ValueError, match="no function at the top of a module"):
        Job(label="a", function=lambda: {"a": 1})
    with pytest.raises(ValueError, match="arguments must be numbers, words"):
        Job(label="a", function=square, arguments={"value": Path()})


def test_checks_that_say_nothing_are_refused() -> None:
    with pytest.raises(ValueError, match="upside down"):
        Check(quantity="a", ours=1.0, reference=(2.0, 1.0))
    with pytest.raises(ValueError, match="is_absolute=True"):
        Check(quantity="a", ours=1.0, reference=0.0, tolerance=0.1)


@pytest.mark.parametrize(
    ("ours", "reference", "tolerance", "verdict"),
    [
        (1.009, 1.0, 0.01, "pass"),
        (1.011, 1.0, 0.01, "MISSED"),
        (-1.011, -1.0, 0.01, "MISSED"),
        (1.5, (1.0, 2.0), None, "pass"),
        (2.1, (1.0, 2.0), None, "MISSED"),
        (2.1, (1.0, 2.0), 0.1, "pass"),
        (1.94, (1.95, inf), None, "MISSED"),
        (7.0, 1.0, None, "recorded"),
        (7.0, None, None, "recorded"),
        (nan, 1.0, 0.01, "MISSED"),
        (nan, (0.0, 2.0), None, "MISSED"),
        (nan, None, None, "MISSED"),
    ],
)
def test_a_check_judges_by_its_reference(
    ours: float,
    reference: float | tuple[float, float] | None,
    tolerance: float | None,
    verdict: str,
) -> None:
    check = Check(quantity="a", ours=ours, reference=reference, tolerance=tolerance)
    assert check.verdict == verdict


def test_fingerprints_follow_what_a_job_reaches(monkeypatch: pytest.MonkeyPatch) -> None:
    from experiments.validation import cavity, poiseuille

    def shot(module: object) -> list[str]:
        jobs = next(c for c in CASES if type(c).__module__ == module.__name__).jobs(quick=True)  # type: ignore[attr-defined]
        return [fingerprint(job) for job in jobs]

    before, other = shot(cavity), shot(poiseuille)
    assert len(set(before)) == len(before)
    monkeypatch.setattr(cavity, "TOLERANCE", 0.5)  # a bar is not part of the run
    assert shot(cavity) == before
    monkeypatch.setattr(cavity, "STEADY", 1e-4)
    assert not set(shot(cavity)) & set(before)
    assert shot(poiseuille) == other


def test_fingerprints_are_the_same_in_every_process() -> None:
    program = (
        "from experiments.validation.catalogue import CASES\n"
        "from experiments.validation.fingerprint import fingerprint\n"
        "print(*(fingerprint(job) for case in CASES for job in case.jobs(quick=False)))"
    )
    answers = [
        subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
        for _ in range(2)
    ]
    first, second = (answer.stdout.split() for answer in answers)
    assert len(first) > 200
    assert first == second


def test_a_bar_in_a_cell_does_not_break_the_table(tmp_path: Path) -> None:
    outcome = Outcome(Squares(diary=tmp_path))
    outcome.checks.append(Check(quantity="|u|", ours=1.0))
    assert "| \\|u\\| |" in render([outcome], figures="figures", command="validate")


def test_cases_have_names_of_their_own_and_quick_runs_are_among_all() -> None:
    assert len({case.name for case in CASES}) == len(CASES)
    for case in CASES:
        labels = [job.label for job in case.jobs(quick=False)]
        assert {job.label for job in case.jobs(quick=True)} <= set(labels)


def test_order_and_extreme_of_known_curves() -> None:
    assert fit_order({n: 3.0 * n**-2.0 for n in (8, 16, 64)}) == pytest.approx(2.0)
    with pytest.raises(ValueError, match="needs two resolutions"):
        fit_order({8: 1.0})
    x = [0.1 * i for i in range(10)]
    assert find_extreme(x, [(p - 0.43) ** 2 - 2.0 for p in x], sign=-1) == pytest.approx(-2.0)
    assert find_extreme(x, x, sign=1) == x[-1]
    with pytest.raises(ValueError, match="not evenly spaced"):
        find_extreme([0.0, 1.0, 3.0], [0.0, 1.0, 0.0], sign=1)
