"""Jobs of a sweep: names, folders, continuation and failures."""

from __future__ import annotations

import shlex
import subprocess
import sys
import time
from contextlib import ExitStack, nullcontext
from pathlib import Path
from typing import Any

import psutil
import pytest

from fishrl.children import start_child
from fishrl.locks import take_lock
from fishrl.presets import list_names
from fishrl.programs import train
from fishrl.programs.sweeps import jobs
from fishrl.programs.sweeps.groups import group_runs
from fishrl.programs.sweeps.jobs import Job, find_runs, plan_jobs
from fishrl.programs.sweeps.runs import read_run, read_runs
from fishrl.programs.train_settings import TRAINING
from fishrl.settings import describe
from fishrl.training import open_run
from fishrl.training.run_folder import write_json, write_yaml
from tests.modules.test_lateral_line import make as make_classifier
from tests.training.conftest import make_run_folder, read_rows

ROOT = Path(__file__).parents[2]
HERE = "tests.training.faults"  # makes fish glide in the runs' own processes
TASK = {"body_length": 20, "reynolds": 500, "max_wall_speed": 0.15, "wall_margin_bl": 0.15}
SETTINGS = [
    *(f"task.{name}={value}" for name, value in TASK.items()),
    *("task.time_limit=4", "flows.compile=false", "flows.num_envs=2"),
    *("total_frames=16", "warmup_frames=4"),
    *("log_frames=4", "checkpoint_frames=4", "batch_size=4", "hidden=[8]", "eval_frames=8"),
    *("eval_episodes=2", "final_episodes=2", "picture_episodes=0", "baselines=[]"),
]


def run_sweep(*arguments: str) -> int:
    """Return the exit code of a sweep, which this process runs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", [*sys.argv])  # hydra reads and changes it
        patch.chdir(ROOT)
        with pytest.raises(SystemExit) as end:
            train.main(["--multirun", *arguments])
    return int(end.value.code or 0)


def test_jobs_are_named_after_what_differs() -> None:
    given = ["seed=1", "++task.time_limit=20", "hidden=[64,64]"]
    assert jobs.name_job(given) == "seed_1-time_limit_20-hidden_64_64_"
    assert jobs.name_job([]) == "run"
    long = [jobs.name_job([f"recognition={'x' * 200}{end}"]) for end in "ab"]
    assert len(set(long)) == 2
    assert max(map(len, long)) <= jobs.LONGEST_NAME


def test_sweep_plans_jobs() -> None:
    line = ["flows.num_envs=2", "seed=0,1", "task.time_limit=range(3,5)", "folder=runs/my sweep"]
    planned = [job.settings for job in plan_jobs(line)[1]]
    expected = [(f"seed_{s}-time_limit_{t}", s, 2, "runs/my sweep") for s in (0, 1) for t in (3, 4)]
    assert [(job.name, job.seed, job.flows.num_envs, job.folder) for job in planned] == expected
    files = [name for name in list_names("preset") if name.startswith("gait")]
    assert len(plan_jobs(["preset=glob(gait*)"])[1]) == len(files)
    assert [job.settings.seed for job in plan_jobs(["seed=0,1,0"])[1]] == [0, 1]
    with pytest.raises(ValueError, match="a setting has no values to sweep over"):
        plan_jobs(["seed=range(0,0)"])


def test_jobs_of_nested_lists_have_a_folder_each() -> None:
    rows = "[[0.5,0.6,1.0,1.1,1.9,2.0]],[[0.5,0.6],[1.0,1.1],[1.9,2.0]],[[0.5,0.6]]"
    launch, planned = plan_jobs(["task=karman_gait", f"task.control.rows={rows}"])
    names = [str(job.settings.name) for job in planned]
    assert len(set(names)) == 3 and names[2] == "rows_0.5_0.6_"
    again = [launch.plan(job.words[:-1]) for job in planned]  # as in its own process
    assert [job.words for job in again] == [job.words for job in planned]


def test_words_of_job_give_its_settings() -> None:
    line = ["seed=0,1", "hidden=[8],[8,8]", "algorithm=dqn", "folder='a, b'"]
    for job in plan_jobs(line)[1]:
        assert describe(TRAINING.read(job.words)) == describe(job.settings)
        assert job.settings.folder == "a, b"


def test_command_line_overrides_sweep_of_experiment(tmp_path: Path) -> None:
    (tmp_path / "experiment").mkdir()
    (tmp_path / "experiment" / "own.yaml").write_text(
        "# @package _global_\nfolder: runs/own\nhydra: {sweeper: {params: {seed: '0,1'}}}"
    )
    line = [f"--config-dir={tmp_path}", "experiment=own"]
    for more, seeds in (([], (0, 1)), (["seed=3,4,5"], (3, 4, 5))):
        paths = [job.path for job in plan_jobs([*line, *more])[1]]
        assert paths == [Path(f"runs/own/seed_{seed}") for seed in seeds]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["hydra/launcher=jobli"], "did you mean 'joblib'"),
        (["algorithm=dqn,discrete_sac", "algorithm.epsilon_frames=9"], "algorithm.epsilon_frames"),
        (["preset=quick,gait_small", "task=predation"], "task.start_flows"),
        (["gamma=0.9,2", "seed=0,1"], "gamma = 2"),
    ],
)
def test_invalid_job_is_refused_first(tmp_path: Path, arguments: list[str], said: str) -> None:
    with pytest.raises(SystemExit, match=said):
        train.main(["--multirun", f"folder={tmp_path}", *arguments])
    assert not list(tmp_path.iterdir())


def begin(folder: Path, *words: str) -> Job:
    """Write a run that is to be trained, as its job does first."""
    (job,) = plan_jobs([f"folder={folder}", *words])[1]
    make_run_folder(job.settings)
    return job


def test_run_continues_only_with_same_settings(tmp_path: Path) -> None:
    first = begin(tmp_path)
    assert find_runs([f"folder={tmp_path}"]) == [first.path]
    assert find_runs([f"folder={tmp_path}", "seed=1,2"]) == []
    assert open_run(first.settings).summary is None
    write_json(first.path / "summary.json", {"frames": 2800})
    assert open_run(first.settings).summary is not None
    (longer,) = plan_jobs([f"folder={tmp_path}", "total_frames=3000", "port=9900"])[1]
    assert open_run(longer.settings).summary is None
    (compared,) = plan_jobs([f"folder={tmp_path}", "baselines=[random]", "log_frames=8"])[1]
    assert open_run(compared.settings).summary is None  # it is evaluated again
    (logged,) = plan_jobs([f"folder={tmp_path}", "log_frames=8"])[1]
    assert open_run(logged.settings).summary is not None
    for word in ("gamma=0.5", "task.reynolds=500", "recognition=oracle", "algorithm=dqn"):
        (other,) = plan_jobs([f"folder={tmp_path}", word])[1]
        with pytest.raises(ValueError, match=rf"is .* in {first.path}; take another folder"):
            open_run(other.settings)
    with pytest.raises(SystemExit, match=r"gamma = 0\.5: is 0\.99 in .*run"):
        train.main(["--multirun", f"folder={tmp_path}", "gamma=0.5"])


def test_other_classifier_makes_another_run(tmp_path: Path) -> None:
    files = [tmp_path / name for name in "abc"]
    for file, width in ((files[0], 3), (files[2], 4)):
        make_classifier(hidden=[width]).save(file)
    files[1].write_bytes(files[0].read_bytes())
    begin(tmp_path, f"recognition.path={files[0]}")
    for file, is_same in zip(files, (True, True, False), strict=True):
        (job,) = plan_jobs([f"folder={tmp_path}", f"recognition.path={file}"])[1]
        if is_same:
            assert open_run(job.settings).summary is None
        else:
            with pytest.raises(ValueError, match="path = classifier "):
                open_run(job.settings)


def test_logging_and_baselines_do_not_split_groups(tmp_path: Path) -> None:
    given = ["port=9900", "live_share=0.2", "shown_flows=[0,1]", "log_frames=8"]
    given += [
        "checkpoint_frames=8",
        "keep_checkpoints=4",
        "picture_episodes=0",
        "baselines=[random]",
        "live=true",
    ]
    given.append("logger=wandb")
    for name, words in {"a": [], "b": given, "c": ["eval_frames=8"]}.items():
        make_run_folder(TRAINING.read([f"folder={tmp_path}", f"name={name}", *words]))
    # which evaluation is the best one depends on when they are made
    assert [len(group.runs) for group in group_runs(read_runs(tmp_path))] == [2, 1]


@pytest.mark.usefixtures("kinematic")
def test_killed_job_alone_is_continued(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    loggers = f"logger._target_={HERE}.Killed,{HERE}.Gliding"
    command = [*SETTINGS, f"folder={tmp_path}", loggers]
    assert run_sweep(*command) == 1
    killed, whole = (tmp_path / f"logger_{HERE}.{name}" for name in ("Killed", "Gliding"))
    assert read_run(whole).status == "finished"
    run = read_run(killed)
    assert (run.status, run.frames) == ("failed", 8)
    assert run.reason == "killed by SIGKILL; see output.log"
    said = capfd.readouterr().out
    assert "1 of 2 runs finished" in said
    (rerun,) = [line.partition("rerun: ")[2] for line in said.splitlines() if "rerun: " in line]
    assert shlex.split(rerun)[1:] == ["train", f"resume={killed}", f"modules=[{HERE}]"]
    train.main(shlex.split(rerun)[2:])
    assert read_run(killed).status == "finished"
    assert read_rows(killed) == read_rows(whole)
    before = (whole / "summary.json").stat().st_mtime_ns
    assert run_sweep(*command) == 0
    assert "2 of 2 runs finished" in capfd.readouterr().out
    assert (whole / "summary.json").stat().st_mtime_ns == before


def test_terminated_sweep_waits_until_its_run_has_saved(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    run = f"""
import os, pathlib, signal, sys, time
def save(*_):
    time.sleep(0.5)
    pathlib.Path({str(tmp_path)!r}, "saved").touch()
    sys.exit(128 + signal.SIGTERM)
signal.signal(signal.SIGTERM, save)
os.kill(os.getppid(), signal.SIGTERM)
time.sleep(600)
"""

    def start(_: str, *words: str, **options: Any) -> Any:
        return start_child(f"exec({run!r})", *words, **options)

    monkeypatch.setattr(jobs, "start_child", start)
    assert run_sweep(f"folder={tmp_path}", "seed=0,1") == 1
    assert (tmp_path / "saved").is_file()
    assert [path.name for path in tmp_path.glob("seed*")] == ["seed_0"]  # the other never began
    assert not list(tmp_path.glob("*/failure.txt"))
    done = capfd.readouterr()
    assert "interrupted; the same command with the same folder=... continues" in done.err
    assert "Traceback" not in done.err and "0 of 2 runs finished" in done.out


def read_pid(file: Path) -> int:
    """Return the number in a file, once it is there."""
    deadline = time.monotonic() + 60.0
    while not (file.is_file() and file.read_text()) and time.monotonic() < deadline:
        time.sleep(0.02)
    return int(file.read_text())


def is_over(pid: int) -> bool:
    return not psutil.pid_exists(pid) or psutil.Process(pid).status() == psutil.STATUS_ZOMBIE


#: A sweep whose job, in a process of its own as joblib's, starts a run that writes its number.
SWEEP = """
import multiprocessing, os, pathlib, sys, time
from fishrl.children import start_child
from fishrl.programs.sweeps import jobs

folder, run = sys.argv[1:]

def start(*_, **options):
    pathlib.Path(folder, "pid_of_job").write_text(str(os.getpid()))
    return start_child(run, **options)

jobs.start_child = start
(job,) = jobs.plan_jobs([f"folder={folder}"])[1]
multiprocessing.get_context("fork").Process(target=jobs.run_job, args=(job,)).start()
time.sleep(600)
"""


def test_job_of_killed_sweep_ends(tmp_path: Path) -> None:
    """In a process of its own, as joblib's, which does not end with the sweep."""
    files = [tmp_path / name for name in ("pid_of_job", "pid_of_run")]
    run = f"import os, time; open({str(files[1])!r}, 'w').write(str(os.getpid())); time.sleep(600)"
    sweep = subprocess.Popen([sys.executable, "-c", SWEEP, str(tmp_path), run])
    left = [read_pid(file) for file in files]
    sweep.kill()
    sweep.wait()
    deadline = time.monotonic() + 60.0
    while not all(map(is_over, left)) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert all(map(is_over, left))


@pytest.mark.sweep
def test_submitit_reports_failed_setup(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    write_yaml(tmp_path / "elsewhere.yaml", {})  # other files are ignored
    launcher = ("hydra/launcher=submitit_local", "hydra.launcher.timeout_min=10")
    command = [f"folder={tmp_path}", "preset=gait_small", "recognition.path=none.pt", "seed=1"]
    assert run_sweep(*command, *launcher) == 1
    assert any(log.stat().st_size > 0 for log in (tmp_path / ".submitit").glob("*/*.out"))
    (run,) = read_runs(tmp_path)
    assert "none.pt" in run.reason
    said = capfd.readouterr()
    assert "failed at frame 0" in said.out
    assert "Traceback" not in said.err


def test_sweeps_have_folders_of_their_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(jobs.time, "strftime", lambda _: "now")
    monkeypatch.setattr(jobs, "run_hydra", lambda *_: None)
    for _ in range(3):
        with pytest.raises(SystemExit):
            train.main(["--multirun", "seed=0,1"])
    found = [shlex.split(path.read_text()) for path in sorted(tmp_path.glob("runs/*/command.txt"))]
    assert [words[-1] for words in found] == [
        f"folder=runs/sweep-now{end}" for end in ("", "-2", "-3")
    ]


@pytest.mark.parametrize("gamma", [0.99, 0.5])
@pytest.mark.parametrize("phase", ["before", "locked", "written", "held", "finished"])
def test_job_of_another_sweep_in_the_same_folder_is_kept_apart_in_any_phase(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, phase: str, gamma: float
) -> None:
    """The other one has gamma = 0.99; this one begins a run only if the other has not begun."""
    started = list[str]()

    def start(_: str, *words: str, **given: object) -> subprocess.Popen[bytes]:
        started.extend(words)
        return subprocess.Popen([sys.executable, "-c", ""])

    def write(seconds: float) -> None:
        """Go on as the other job does while this one looks."""
        if not (tmp_path / "run/config.yaml").is_file():
            make_run_folder(other.settings)

    monkeypatch.setattr(jobs, "start_child", start)
    monkeypatch.setattr(jobs.time, "sleep", write if phase == "locked" else lambda _: None)
    (other,), (job,) = (plan_jobs([f"folder={tmp_path}", f"gamma={g}"])[1] for g in (0.99, gamma))
    with ExitStack() as stack:
        if phase != "before":
            other.path.mkdir()
            log = stack.enter_context((other.path / "output.log").open("ab"))
            assert take_lock(log)
        if phase in ("written", "held", "finished"):
            make_run_folder(other.settings)
        if phase == "held":
            monkeypatch.setattr("fishrl.programs.sweeps.runs.is_held", lambda _: True)
        if phase == "finished":
            write_json(other.path / "summary.json", {"frames": 10**6})
            log.close()
        is_other = gamma != 0.99 and phase != "before"
        with (
            pytest.raises(ValueError, match=r"gamma = 0\.5: is 0\.99")
            if is_other
            else nullcontext()
        ):
            jobs.run_job(job)
    assert bool(started) == (phase == "before")
    assert not (job.path / "failure.txt").exists()
