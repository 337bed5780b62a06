"""What a run survives: signals, a full disk, folders that cannot be written, flows that diverge."""

from __future__ import annotations

import gc
import json
import logging
import os
import resource
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import torch

from experiments.command_line import show_command
from experiments.config import load_config
from experiments.settings import TrainConfig
from experiments.train import set_up
from fishrl.training.checkpoint import CheckpointNotWritten, load_checkpoint, read_metadata
from fishrl.training.interruption import Interrupted, Interruption, spare_children
from fishrl.training.logger import CsvLogger
from fishrl.training.loop import Training
from fishrl.training.metrics import measure_memory_mb
from fishrl.training.run_folder import write_whole
from tests.envs.conftest import SMALL, gliding  # noqa: F401 - a fixture
from tests.envs.gliding import GlidingSolver
from tests.experiments.test_output import read
from tests.training.stops import run_and_stop
from tests.training.test_checkpoint import BRAIN, save
from tests.training.test_loop import ROOT, rows_of
from tests.training.toy_fish import ToyFishEnv, make_toy_env

MakeConfig = Callable[..., TrainConfig]
QUICK: dict[str, Any] = {"baselines": [], "eval_episodes": 2, "final_episodes": 2}


def training_of(config: TrainConfig) -> Training:
    return set_up(config, make_env=make_toy_env)


def weights_of(training: Training) -> dict[str, torch.Tensor]:
    return dict(training.learner.loss.state_dict())


@contextmanager
def limited_disk(num_bytes: int) -> Iterator[None]:
    """Let no file grow beyond a size: what a full disk does, for this process alone."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (num_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize("during", ["collecting", "evaluating"])
def test_a_run_told_to_end_saves_and_goes_on_as_if_nothing_had_been(
    toy_config: MakeConfig, tmp_path: Path, during: str
) -> None:
    whole = training_of(toy_config(name="whole", **QUICK))
    whole.run()
    part = training_of(toy_config(name="part", **QUICK))
    is_late = during == "evaluating"
    run_and_stop(part, ToyFishEnv, step=3 if is_late else 23, evaluating=is_late)
    frames = 184 if during == "collecting" else 120
    assert read_metadata(tmp_path / "part", which="last")[1]["frames"] == frames
    assert all(int(row["frames"]) < 184 for row in rows_of(tmp_path / "part"))
    resumed = training_of(toy_config(resume=str(tmp_path / "part"), **QUICK))
    assert resumed.counters.frames == frames
    assert bool(resumed.counters.pending) == (during == "evaluating")
    resumed.run()
    assert rows_of(tmp_path / "part") == rows_of(tmp_path / "whole")
    theirs = weights_of(whole)
    assert all(torch.equal(value, theirs[name]) for name, value in weights_of(resumed).items())


SIGNALLED_RUN = """
import json, os, signal, sys
from experiments.command_line import plain_errors, resumable
from experiments.settings import TrainConfig
from experiments.train import finish, set_up
from tests.training.toy_fish import ToyFishEnv, make_toy_env
step, num_steps, number = ToyFishEnv._step, [0], int(sys.argv[2])
def step_and_signal(self, td):
    num_steps[0] += 1
    if num_steps[0] >= 5 and num_steps[0] - 5 < int(sys.argv[3]):
        os.kill(os.getpid(), number)
    return step(self, td)
ToyFishEnv._step = step_and_signal
with plain_errors():
    training = set_up(TrainConfig(**json.loads(sys.argv[1])), make_env=make_toy_env)
    with resumable(training):
        finish(training)
"""


def run_signalled(config: TrainConfig, number: int, count: int) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [
            sys.executable,
            "-c",
            SIGNALLED_RUN,
            json.dumps(vars(config)),
            str(int(number)),
            str(count),
        ],
        cwd=ROOT,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        check=False,
        capture_output=True,
        text=True,
    )


def test_a_signal_ends_the_program_with_one_line_and_everything_saved(
    toy_config: MakeConfig, tmp_path: Path
) -> None:
    number = signal.SIGTERM
    done = run_signalled(toy_config(name="run", **QUICK), number, 1)
    assert done.returncode == 128 + number, done.stderr
    command = show_command("experiments.train", f"resume={tmp_path / 'run'}")
    hint = f"go on with: {command}"
    assert f"{number.name}: saved at frame 40; {hint}" in done.stderr
    assert "Traceback" not in done.stderr
    assert read_metadata(tmp_path / "run", which="last")[1]["frames"] == 40


def test_a_second_signal_ends_it_at_once(toy_config: MakeConfig, tmp_path: Path) -> None:
    interruption, before = Interruption(), signal.getsignal(signal.SIGINT)
    with interruption:
        signal.raise_signal(signal.SIGTERM)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is before
    Interruption().check()
    with pytest.raises(Interrupted):
        interruption.check()


def test_the_same_signal_told_twice_at_once_is_one(monkeypatch: pytest.MonkeyPatch) -> None:
    interruption = Interruption()
    with interruption:
        signal.raise_signal(signal.SIGTERM)
        signal.raise_signal(signal.SIGTERM)
        monkeypatch.setattr("fishrl.training.interruption.TWICE_SECONDS", 0.0)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)
    with pytest.raises(Interrupted):
        interruption.check()


def test_processes_of_the_flows_do_not_hear_what_the_run_is_told() -> None:
    sleep = [sys.executable, "-c", "input()"]
    with spare_children():
        spared = subprocess.Popen(sleep, stdin=subprocess.PIPE)
    for number in (signal.SIGINT, signal.SIGTERM):
        spared.send_signal(number)
    with pytest.raises(subprocess.TimeoutExpired):
        spared.wait(0.5)
    spared.communicate(b"\n")
    assert spared.returncode == 0
    assert not signal.pthread_sigmask(signal.SIG_BLOCK, []) & {signal.SIGINT, signal.SIGTERM}


def test_older_checkpoints_stay_as_many_as_wished(toy_config: MakeConfig, tmp_path: Path) -> None:
    training_of(toy_config(name="run", keep_checkpoints=3, **QUICK)).run()
    folder = tmp_path / "run" / "checkpoints"
    names = sorted(path.name for path in folder.iterdir())
    assert names == ["best", "last", "last-000000080", "last-000000160"]
    for name, frames in (("last", 240), ("last-000000080", 80), ("last-000000160", 160)):
        assert read_metadata(folder / name)[1]["frames"] == frames


def test_an_older_checkpoint_takes_the_place_of_a_corrupt_one(
    toy_config: MakeConfig, tmp_path: Path
) -> None:
    training_of(toy_config(name="run", **QUICK)).run()
    folder = tmp_path / "run" / "checkpoints"
    (folder / "last" / "manifest.json").write_text("{")
    with pytest.raises(ValueError, match="or delete it, and last-000000160 takes its place"):
        training_of(toy_config(resume=str(tmp_path / "run")))
    (folder / "last" / "manifest.json").unlink()
    (folder / "last").rename(tmp_path / "broken")
    resumed = training_of(toy_config(resume=str(tmp_path / "run")))
    assert resumed.counters.frames == 160


@pytest.mark.parametrize("is_killed", [False, True])
def test_a_run_cut_off_in_its_first_checkpoint_begins_anew(
    toy_config: MakeConfig, tmp_path: Path, is_killed: bool
) -> None:
    run = tmp_path / "run"
    training = training_of(toy_config(name="run", **QUICK))
    with limited_disk(1000), pytest.raises(CheckpointNotWritten, match="there is none yet"):
        training.run()
    training.close()
    if is_killed:
        (run / "checkpoints" / "..last.new.stage-0a1b").mkdir()
    resumed = training_of(toy_config(resume=str(run), total_frames=40, **QUICK))
    resumed.run()
    assert not list((run / "checkpoints").glob("..*"))
    assert [row["frames"] for row in rows_of(run)] == ["40"]


@pytest.mark.parametrize("left", [".last.new", ".last.backup", "last-000000007"])
def test_a_kill_between_the_renames_loses_nothing(tmp_path: Path, left: str) -> None:
    save(tmp_path / "last")
    (tmp_path / "last").rename(tmp_path / left)
    assert read_metadata(tmp_path / "last")[1]["frames"] == 7
    save(tmp_path / "last", value=2.0)
    fresh = torch.nn.Linear(3, 2)
    load_checkpoint(tmp_path / "last", {"net": fresh}, brain=BRAIN)
    assert (fresh.weight == 2.0).all()


def test_a_full_disk_is_named_and_the_checkpoint_before_is_as_it_was(tmp_path: Path) -> None:
    save(tmp_path / "last", value=1.0)
    with (
        limited_disk(1000),
        pytest.raises(CheckpointNotWritten, match=r"cannot be written \(.*the one of frame 7"),
    ):
        save(tmp_path / "last", value=2.0)
    assert [path.name for path in tmp_path.iterdir()] == ["last"]
    fresh = torch.nn.Linear(3, 2)
    load_checkpoint(tmp_path / "last", {"net": fresh}, brain=BRAIN)
    assert (fresh.weight == 1.0).all()


def test_an_error_that_is_not_the_disks_is_not_taken_for_it(tmp_path: Path) -> None:
    class Broken(torch.nn.Linear):
        def state_dict(self, *args: Any, **kwargs: Any) -> Any:
            raise RuntimeError("a flow worker failed")

    from fishrl.training.checkpoint import save_checkpoint

    with pytest.raises(RuntimeError, match="a flow worker failed"):
        save_checkpoint(
            tmp_path / "last",
            {"net": Broken(1, 1)},
            brain=BRAIN,
            preset="small",
            frames=7,
            config={},
        )


def test_a_folder_that_cannot_be_written_any_more_is_named(read_only_folder: Path) -> None:
    with pytest.raises(CheckpointNotWritten, match=r"\(Permission denied\); there is none yet"):
        save(read_only_folder / "last")


def test_a_run_outlives_a_full_disk(
    toy_config: MakeConfig,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    whole = training_of(toy_config(name="whole", **QUICK))
    whole.run()
    training = training_of(toy_config(name="run", **QUICK))
    conclude = Training._conclude

    def conclude_on_a_full_disk(self: Training, plain: dict[str, Any]) -> dict[str, float]:
        if not 80 < self.counters.frames < 200:
            return conclude(self, plain)
        with limited_disk((tmp_path / "run" / "metrics.csv").stat().st_size):
            metrics = conclude(self, plain)
        assert read_metadata(tmp_path / "run", which="last")[1]["frames"] == 80
        return metrics

    monkeypatch.setattr(Training, "_conclude", conclude_on_a_full_disk)
    with caplog.at_level(logging.ERROR, logger="experiments"):
        training.run()
    assert "best: cannot be written" in caplog.text
    assert "the one of frame 80 is still there" in caplog.text
    assert "metrics.csv: 1 rows cannot be written (File too large)" in caplog.text
    assert rows_of(tmp_path / "run") == rows_of(tmp_path / "whole")
    assert read_metadata(tmp_path / "run", which="last")[1]["frames"] == 240


def test_a_run_whose_last_checkpoint_cannot_be_written_says_so(toy_config: MakeConfig) -> None:
    training = training_of(toy_config(name="run", total_frames=40, **QUICK))
    training.run()
    training.config.total_frames = 80
    with limited_disk(2000), pytest.raises(CheckpointNotWritten, match="the one of frame 40 is"):
        training.run()


def test_rows_that_cannot_be_written_at_the_end_are_named(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    log = CsvLogger()
    log.open(tmp_path, columns=["frames"], config={})
    with limited_disk(8):
        log.log({"frames": 123456})
        log.close()
    assert caplog.text.count("1 rows cannot be written") == 2
    assert read(tmp_path / "metrics.csv") == []
    log.close()
    assert read(tmp_path / "metrics.csv") == [{"frames": "123456"}]


def test_a_file_is_written_whole_or_not_at_all(tmp_path: Path) -> None:
    write_whole(tmp_path / "a", "before")
    with limited_disk(3), pytest.raises(OSError, match="File too large"):
        write_whole(tmp_path / "a", "afterwards")
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("a", "before")]


@pytest.mark.usefixtures("gliding")
@pytest.mark.parametrize("algorithm", ["discrete_sac", "drqn"])
def test_a_flow_that_diverges_never_stops_a_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, algorithm: str
) -> None:
    advance, num_calls = GlidingSolver.advance_, [0]

    def advance_and_break(self: GlidingSolver, *args: Any) -> None:
        advance(self, *args)
        num_calls[0] += 1
        if num_calls[0] % 29 == 0:  # of training and evaluation alike
            self.body.position[num_calls[0] % self.num_envs] = torch.nan

    monkeypatch.setattr(GlidingSolver, "advance_", advance_and_break)
    settings = [
        *(f"task.{name}={value}" for name, value in SMALL.items()),
        *("compile=false", "num_envs=3", "total_frames=120", "warmup_frames=30", "hidden=[16]"),
        *("buffer_size=200", "updates_per_frame=0.3", "eval_frames=60", "eval_episodes=3"),
        *("final_episodes=3", "picture_episodes=0", "baselines=[]", f"folder={tmp_path}"),
    ]
    training = set_up(load_config("train", [*settings, f"algorithm={algorithm}"]))
    summary = training.run()
    assert summary["train_diverged"] > 1
    assert summary["frames"] == 120
    remembered = training.learner.buffer[:]
    assert len(remembered) == 120 - summary["train_diverged"]
    assert all(value.isfinite().all() for value in remembered.values(True, True))
    assert all(value.isfinite().all() for value in weights_of(training).values())


def count_tensors() -> int:
    gc.collect()
    return sum(isinstance(thing, torch.Tensor) for thing in gc.get_objects())


@pytest.mark.parametrize("name", ["DiscreteSAC", "DRQN"])
def test_memory_stays_flat(toy_config: MakeConfig, name: str) -> None:
    config = toy_config(
        algorithm={"_target_": f"fishrl.training.algorithms.{name}"},
        buffer_size=100,
        total_frames=160,
        task={"time_limit": 5},
        eval_frames=80,
        **QUICK,
    )
    training = training_of(config)
    training.run()
    tensors, megabytes = count_tensors(), measure_memory_mb()
    config.total_frames = 400
    training.run()
    assert count_tensors() <= tensors + 5
    assert measure_memory_mb() < megabytes + 10.0  # allocators keep some; a frame is 5 kB
    assert megabytes > 50.0
