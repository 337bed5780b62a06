"""The search with Optuna: its ranges, resumed studies, and failed trials."""

from __future__ import annotations

import subprocess
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from threading import Barrier
from typing import Any

import pytest

from fishrl.programs import search, train
from fishrl.programs.search import SearchSettings
from fishrl.programs.sweeps import jobs
from fishrl.programs.sweeps.runs import Run, is_held, read_run, read_runs
from fishrl.programs.train_settings import TRAINING
from fishrl.training.checkpoint import read_metadata
from fishrl.training.runs import make_folder
from tests.programs.test_summarize import hold_elsewhere
from tests.programs.test_sweep_jobs import HERE, SETTINGS

optuna = pytest.importorskip("optuna", reason="pip install -e '.[sweep]'")
pytestmark = pytest.mark.sweep


def plan_of(folder: Path, *overrides: str, trials: int = 20, **others: Any) -> SearchSettings:
    return SearchSettings(folder=str(folder), overrides=overrides, trials=trials, **others)


def test_every_kind_of_range_is_searched(tmp_path: Path) -> None:
    plan = plan_of(
        tmp_path,
        "gamma=interval(0.9,1)",
        "learning_rate=tag(log,interval(1e-5,1e-2))",
        "batch_size=int(interval(16,128))",
        "hidden=choice([64],[64,64])",
        "task.time_limit=10,20",
        "preset=paper",
    )
    made = optuna.distributions
    assert plan.space() == {
        "gamma": made.FloatDistribution(0.9, 1.0),
        "learning_rate": made.FloatDistribution(1e-5, 1e-2, log=True),
        "batch_size": made.IntDistribution(16, 128),
        "hidden": made.CategoricalDistribution(["[64]", "[64,64]"]),
        "++task.time_limit": made.CategoricalDistribution(["10", "20"]),
    }
    assert plan.fixed == ["preset=paper"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["preset=small"], "nothing to search"),
        (["gama=interval(0,1)"], "did you mean 'gamma'"),
        (["gamma=interval(0,1)", "task.time_limt=3"], "did you mean 'task.time_limit'"),
        (["gamma=interval(0,1)", "seed=1"], "seed: is set by the search"),
        (["gamma=interval(1,0)"], "low"),
        (["gamma=interval(0,1)", "trials=0"], "trials = 0"),
    ],
)
def test_what_cannot_be_searched_is_named(tmp_path: Path, arguments: list[str], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        search.main.read([f"folder={tmp_path / 'new'}", *arguments])
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("kinematic")
def test_a_trial_that_was_cut_off_is_finished_before_new_ones(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def run_here(job: jobs.Job) -> Run:
        if not job.path.exists():
            train.main(job.words)
        return read_run(job.path)

    monkeypatch.setattr(search, "run_job", run_here)
    line = [*SETTINGS, "gamma=interval(0.9,1)"]
    plan = plan_of(tmp_path, *line, metric="mean_length_T")
    study = search.open_study(plan)
    cut_off = study.ask(plan.space())  # and then the process was killed
    study = search.search(replace(plan, trials=2))
    assert [trial.state.name for trial in study.trials] == ["COMPLETE", "COMPLETE"]
    assert study.trials[0].params == cut_off.params
    runs = read_runs(tmp_path)
    assert [run.path.name for run in runs] == ["trial_0000-seed_0", "trial_0001-seed_0"]
    for trial, run in zip(study.trials, runs, strict=True):
        assert run.config["gamma"] == trial.params["gamma"]
        assert run.summary["mean_length_T"] == trial.value
    assert len(search.search(replace(plan, trials=2)).trials) == 2  # nothing is left to do
    with pytest.raises(ValueError, match="holds another search"):
        search.search(plan_of(tmp_path, *line, "batch_size=8", metric="mean_length_T"))
    gamma = f"gamma={runs[0].config['gamma']}"
    with pytest.raises(ValueError, match=r"metric = mean_retrun: not in .*'mean_return'"):
        search.run_seed(plan_of(tmp_path, *line, metric="mean_retrun"), 0, [gamma], 0)


def test_a_stored_trial_of_another_search_is_not_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = plan_of(tmp_path / "50%20 what?{x}#é", "gamma=interval(0,1)", trials=1)
    study = search.open_study(plan)
    study.ask({"gamma": optuna.distributions.CategoricalDistribution(["{_target_: planted.X}"])})
    monkeypatch.setattr(search, "run_seed", lambda *_: pytest.fail("run"))
    assert [trial.state.name for trial in search.search(plan).trials] == ["FAIL"]
    assert [path.name for path in tmp_path.iterdir()] == [plan.path.name]


def test_a_search_that_is_ended_saves_its_trial_and_leaves_it_unfinished(
    tmp_path: Path,
) -> None:
    line = [*SETTINGS, f"logger._target_={HERE}.Ending", "gamma=interval(0.9,1)"]
    with pytest.raises(SystemExit, match=r"^interrupted; the same command continues$"):
        search.main([f"folder={tmp_path}", *line])
    run = tmp_path / "trial_0000-seed_0"
    assert not is_held(run)  # nothing is left behind
    assert (read_run(run).status, read_metadata(run, which="last")[1]["frames"]) == ("stopped", 8)
    study = optuna.load_study(study_name="search", storage=f"sqlite:///{tmp_path / 'study.db'}")
    (trial,) = study.trials
    assert trial.state.name == "RUNNING"  # which the same command takes up


def test_a_run_that_outlived_its_search_is_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = plan_of(tmp_path, "gamma=interval(0.9,1)")
    words = ["gamma=0.95", "seed=0", f"folder={tmp_path}", "name=trial_0000-seed_0"]
    place, _ = make_folder(TRAINING.read(words))
    result = tmp_path / "result"
    result.write_text('{"mean_return": 2.5, "frames": 2800}')
    then = f"sys.stdin.readline(); import os; os.rename({str(result)!r}, {str(place.summary)!r})"

    def look(job: jobs.Job) -> Run:
        run = jobs.run_job(job)  # leaves a run alone that another process writes
        if run.status == "running":
            holder.stdin.write(b"\n")  # and it ends
            holder.stdin.flush()
        return run

    monkeypatch.setattr(search, "run_job", look)
    with hold_elsewhere(place.path, then) as holder:
        monkeypatch.setattr(subprocess, "Popen", lambda *_, **__: pytest.fail("run again"))
        assert search.run_seed(plan, 0, ["gamma=0.95"], 0) == 2.5


def test_failed_trials_are_recorded_and_others_follow(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(search, "run_seed", lambda *_: None)
    line = [f"folder={tmp_path}", "gamma=interval(0,1)", "trials=3"]
    search.main(line)
    assert "0 of 3 trials finished" in capsys.readouterr().out
    study = search.search(search.main.read(line))
    assert [trial.state.name for trial in study.trials] == ["FAIL"] * 3
    assert len({trial.params["gamma"] for trial in study.trials}) == 3  # nothing is drawn twice


def test_searches_that_begin_at_once_draw_different_settings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sampler, lock, both = optuna.samplers.TPESampler, search.take_lock, Barrier(2)

    def meet(file: Any, **how: Any) -> None:
        both.wait(60.0)  # neither has counted the trials yet
        lock(file, **how)

    def hesitate(*, seed: int | None = None) -> Any:
        time.sleep(0.5)  # the other search counts the trials meanwhile
        return sampler(seed=seed)

    monkeypatch.setattr(search, "run_trial", lambda *_: None)
    plan = plan_of(tmp_path, "gamma=interval(0,1)")
    study = search.open_study(plan)
    monkeypatch.setattr(optuna.samplers, "TPESampler", hesitate)
    monkeypatch.setattr(search, "take_lock", meet)
    with ThreadPoolExecutor() as pool:
        list(pool.map(search.search, [replace(plan, trials=1)] * 2))
    assert len({trial.params["gamma"] for trial in study.trials}) == len(study.trials) == 2


def test_two_searches_share_a_study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = plan_of(tmp_path, "gamma=interval(0,1)")
    study = search.open_study(plan)
    for _ in range(3):
        study.ask(plan.space())  # by the other search

    def run_seed(_: SearchSettings, number: int, *__: object) -> float:
        if number == 1:
            study.tell(2, 5.0)  # which the other search finishes meanwhile
        return 1.0

    monkeypatch.setattr(search, "run_seed", run_seed)
    place = search.RunFolder(tmp_path / ".trials" / "0000")
    place.path.mkdir(parents=True)
    with hold_elsewhere(place.path):
        study = search.search(replace(plan, trials=3))
    assert [trial.state.name for trial in study.trials] == ["RUNNING", "COMPLETE", "COMPLETE"]
    assert [trial.value for trial in study.trials] == [None, 1.0, 5.0]
