"""Jobs of a sweep: their names and folders, and that a failed one does not affect the others."""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
import sys
from dataclasses import asdict, replace
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from fishrl.programs import train
from fishrl.programs.configuration import CONF
from fishrl.programs.program import show_command
from fishrl.programs.sweeps import ending, jobs
from fishrl.programs.sweeps.groups import group_runs
from fishrl.programs.sweeps.runs import Run, read_run, read_runs
from fishrl.programs.train_settings import TRAINING, TrainConfig
from fishrl.training.checkpoint import read_metadata
from fishrl.training.description import to_plain
from fishrl.training.run_folder import RunFolder, write_json, write_yaml
from tests.training.conftest import read_rows

ROOT = Path(__file__).parents[2]
HERE = "tests.training.faults"  # makes fish glide in the runs' own processes
TASK = {"body_length": 20, "reynolds": 500, "max_wall_speed": 0.15, "wall_margin_bl": 0.15}
SETTINGS = [
    *(f"task.{name}={value}" for name, value in TASK.items()),
    *("task.time_limit=4", "compile=false", "num_envs=2", "total_frames=16", "warmup_frames=4"),
    *("log_frames=4", "checkpoint_frames=4", "batch_size=4", "hidden=[8]", "eval_frames=8"),
    *("eval_episodes=2", "final_episodes=2", "picture_episodes=0", "baselines=[]"),
]


def run_sweep(*arguments: str) -> int:
    """Return the exit code of a sweep."""
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


def test_jobs_are_listed_and_named_before_they_run() -> None:
    line = ["num_envs=2", "seed=0,1", "task.time_limit=range(3,5)", "folder=runs/my sweep"]
    planned = jobs.plan_jobs(line)
    assert [name for name, _ in planned] == [
        *("seed_0-time_limit_3", "seed_0-time_limit_4", "seed_1-time_limit_3"),
        "seed_1-time_limit_4",
    ]
    assert [(job.seed, job.num_envs, job.folder) for _, job in planned[1:3]] == [
        *((0, 2, "runs/my sweep"), (1, 2, "runs/my sweep")),
    ]
    files = list((CONF / "preset").glob("gait*"))
    assert len(jobs.plan_jobs(["preset=glob(gait*)"])) == len(files)
    (_, first), _ = jobs.plan_jobs(["seed=0,1"])
    assert first.folder.startswith("runs/sweep-")


@pytest.mark.parametrize("argument", ["name=x", "resume=runs/x", "folder=a,b"])
def test_what_every_run_of_a_sweep_needs_for_itself_is_refused(argument: str) -> None:
    with pytest.raises(ValueError, match="named after what differs"):
        jobs.plan_jobs([argument])


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["hydra/launcher=jobli"], "did you mean 'joblib'"),
        (
            ["algorithm=dqn,discrete_sac", "algorithm.epsilon_frames=100"],
            "algorithm.epsilon_frames",
        ),
        (["preset=small,gait_half", "task=predation"], "task.start_flows"),
        (["gamma=0.9,2", "seed=0,1"], "gamma = 2"),
    ],
)
def test_a_mistake_in_any_job_ends_the_sweep_before_it_begins(
    tmp_path: Path, arguments: list[str], said: str
) -> None:
    with pytest.raises(SystemExit, match=said):
        train.main(["--multirun", f"folder={tmp_path}", *arguments])
    assert not list(tmp_path.iterdir())


def settings_in(folder: Path, **settings: object) -> TrainConfig:
    config: TrainConfig = TRAINING.read([f"folder={folder}"])
    return replace(config, **settings)


def test_the_same_settings_find_their_run_and_others_make_a_new_one(tmp_path: Path) -> None:
    first = jobs.find_or_begin(settings_in(tmp_path), name="run")
    again = jobs.find_or_begin(settings_in(tmp_path), name="run")
    other = jobs.find_or_begin(settings_in(tmp_path, gamma=0.5), name="run")
    assert [folder.path.name for folder in (first, again, other)] == ["run", "run", "run-2"]
    assert OmegaConf.load(other.config).gamma == 0.5
    stored = OmegaConf.load(first.config)
    del stored.learner_device, stored.task.food_still_T  # of before there were such settings
    OmegaConf.save(stored, first.config)
    assert jobs.find_or_begin(settings_in(tmp_path), name="run").path == first.path
    (tmp_path / "never").mkdir()
    (tmp_path / "never" / "failure.txt").write_text("gamma = 2: must be at most 1")
    mended = jobs.find_or_begin(settings_in(tmp_path), name="never")
    assert read_run(mended.path).status == "stopped"


def test_settings_that_an_algorithm_adapts_find_their_run_too(tmp_path: Path) -> None:
    config = TRAINING.read([f"folder={tmp_path}", "algorithm=ppo"])
    first, again = (jobs.find_or_begin(config, name="run") for _ in range(2))
    assert first.path == again.path
    assert OmegaConf.load(first.config).buffer_size == config.num_envs * 32 != config.buffer_size


def go_on(folder: RunFolder, *changes: str) -> None:
    """Store settings as a resume with other ones does."""
    settings = TRAINING.read([f"resume='{folder.path}'", *changes])
    write_yaml(folder.config, to_plain(asdict(settings)) | {"resume": None})


def test_a_run_that_was_resumed_stays_in_its_sweep_unless_it_learns_something_else(
    tmp_path: Path,
) -> None:
    folders = [jobs.find_or_begin(settings_in(tmp_path, seed=seed), name="run") for seed in (0, 1)]
    given = ["port=9900", "live_share=0.2", "flows=[0,1]", "log_frames=8", "checkpoint_frames=8"]
    given += ["keep_checkpoints=4", "picture_episodes=0", "baselines=[random]", "live=true"]
    go_on(folders[0], *given)
    assert OmegaConf.load(folders[0].config).log_frames == 8
    assert len(group_runs(read_runs(tmp_path))) == 1
    assert jobs.find_or_begin(settings_in(tmp_path), name="run").path == folders[0].path
    # which evaluation is the best one depends on when they are made
    go_on(folders[1], "eval_frames=8")
    assert len(group_runs(read_runs(tmp_path))) == 2
    assert jobs.find_or_begin(settings_in(tmp_path, seed=1), name="run").path.name == "run-3"


def test_a_run_with_another_classifier_is_another_run(tmp_path: Path) -> None:
    files = [tmp_path / name for name in "abc"]
    for file, content in zip(files, (b"1", b"1", b"2"), strict=True):
        file.write_bytes(content)
    folders = []
    for given in (*map(str, files), "zoo/gait_narrow", "zoo/gait_narrow"):
        config = settings_in(tmp_path, recognition=given)
        folders.append(jobs.find_or_begin(config, name="run").path.name)
    assert folders == ["run", "run", "run-2", "run-3", "run-3"]


def test_a_killed_job_leaves_the_others_and_goes_on_alone(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
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
    assert f"rerun: {run.command}" in said
    alone = subprocess.run(
        [sys.executable, "-m", "fishrl", *shlex.split(run.command)[1:]], cwd=ROOT, check=False
    )
    assert alone.returncode == 0
    assert read_rows(killed) == read_rows(whole)  # as if nothing had happened
    before = (whole / "summary.json").stat().st_mtime_ns
    assert run_sweep(*command) == 0  # nothing is left to do
    assert "2 of 2 runs finished" in capfd.readouterr().out
    assert (whole / "summary.json").stat().st_mtime_ns == before


def test_a_repeated_sweep_takes_changes_of_what_is_logged_and_compared(tmp_path: Path) -> None:
    command = [*SETTINGS, f"folder={tmp_path}", f"logger._target_={HERE}.Gliding"]
    assert run_sweep(*command) == 0
    assert run_sweep(*command, "baselines=[random]", "log_frames=8") == 0
    (run,) = read_runs(tmp_path)
    assert run.summary["baselines"] == ["random"]
    assert run.config["log_frames"] == 8


def test_a_sweep_that_is_ended_saves_its_runs(tmp_path: Path) -> None:
    command = ["-m", "fishrl", "train", "--multirun", *SETTINGS, f"folder={tmp_path}", "seed=0,1"]
    command.append(f"logger._target_={HERE}.Ending")
    done = subprocess.run(
        [sys.executable, *command], cwd=ROOT, check=False, capture_output=True, text=True
    )
    assert done.returncode == 1
    assert "interrupted; the same command with the same folder=... goes on" in done.stderr
    assert "Traceback" not in done.stderr
    run, other = read_runs(tmp_path)  # which never began
    assert (other.status, other.frames) == ("stopped", 0)
    assert (run.status, run.frames) == ("stopped", 8)
    assert read_metadata(run.path, which="last")[1]["frames"] == 8
    said = (run.path / "output.log").read_text(encoding="utf-8")
    command = show_command("train", "resume=")
    assert f"SIGTERM: saved at frame 8; resume with: {command}" in said
    assert f"rerun: {run.command}" in done.stdout
    assert "0 of 2 runs finished" in done.stdout


def test_a_run_that_was_ended_has_not_failed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = jobs.find_or_begin(settings_in(tmp_path), name="run")
    for code, status in ((128 + signal.SIGTERM, "stopped"), (3, "failed")):
        training = folder.path / "training"
        training.write_text(f"#!/bin/sh\nexit {code}\n")
        training.chmod(0o700)
        with monkeypatch.context() as patch:
            patch.setattr(sys, "executable", str(training))
            assert jobs.run_alone(folder.path).status == status


def test_trainings_below_a_process_end_before_it() -> None:
    code = "print('ready', flush=True); import sys; sys.stdin.read()"
    command = [sys.executable, "-c", code, "train", "resume=x"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as run:
        assert run.stdout is not None
        assert run.stdout.readline() == b"ready\n"
        assert ending.find_trainings() == {run.pid}
        with pytest.raises(KeyboardInterrupt), ending.ending_runs():
            os.kill(os.getpid(), signal.SIGTERM)
        assert run.wait() == -signal.SIGTERM
    assert ending.find_trainings() == set()


@pytest.mark.usefixtures("heeds_ctrl_c")
def test_a_sweep_goes_on_ignoring_the_signals_that_it_ignored() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with ending.ending_runs():
        assert signal.getsignal(signal.SIGINT) == signal.SIG_IGN
        assert signal.getsignal(signal.SIGTERM) != signal.SIG_DFL


def test_a_sweep_is_judged_by_its_own_jobs(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    jobs.find_or_begin(settings_in(tmp_path, gamma=0.5), name="run")  # and never trained

    def finish(path: Path, *_: object) -> Run:
        write_json(RunFolder(path).summary, {"mean_return": 0.0})
        return read_run(path)

    monkeypatch.setattr(jobs, "run_alone", finish)
    assert run_sweep(f"folder={tmp_path}") == 0
    assert "1 of 1 runs finished" in capfd.readouterr().out
    assert run_sweep(f"folder={tmp_path}", "algorithm=sac") == 1  # not for discrete actions
    assert "run-3: failed at frame 0" in capfd.readouterr().out


def test_jobs_that_cannot_be_set_up_are_all_named(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    command = [f"folder={tmp_path}", "preset=gait_small", "recognition=none.pt", "seed=0,1"]
    assert run_sweep(*command) == 1
    assert all("none.pt" in run.reason for run in read_runs(tmp_path))
    said = capfd.readouterr()
    assert "seed_1: failed at frame 0" in said.out
    assert "Traceback" not in said.err
