"""The training loop on the point fish: what it writes, repeats, resumes and leaves out."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
import torch
from omegaconf import OmegaConf

from experiments.config import resumed_settings
from experiments.settings import ConfigError, TrainConfig
from experiments.sweeps.runs import read_run
from experiments.train import begin_run, finish, is_over, main, note_settings, set_up, train
from fishrl.training.evaluation import Evaluation
from fishrl.training.interruption import Interrupted
from fishrl.training.loop import Training
from fishrl.training.metrics import list_metrics
from fishrl.training.progress import Progress
from fishrl.training.run_folder import RunFolder
from tests.training.stops import run_and_stop
from tests.training.toy_fish import ToyFishEnv, make_toy_env

ROOT = Path(__file__).parents[2]
MakeConfig = Callable[..., TrainConfig]


def rows_of(folder: Path) -> list[dict[str, str]]:
    """Read metrics.csv without what depends on the machine."""
    with (folder / "metrics.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    return [{k: v for k, v in row.items() if not k.startswith("time/")} for row in rows]


def training_of(config: TrainConfig) -> Training:
    return set_up(config, make_env=make_toy_env)


def test_a_run_writes_its_settings_metrics_checkpoints_and_summary(
    toy_config: MakeConfig, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    summary = train(toy_config(), make_env=make_toy_env)
    folder = tmp_path / "toypredation-toy-seed0"
    assert (folder / "config.yaml").is_file()
    assert (folder / "checkpoints" / "best" / "manifest.json").is_file()
    assert (folder / "checkpoints" / "last" / "manifest.json").is_file()
    with (folder / "metrics.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    losses = ("loss_actor", "loss_qvalue", "loss_alpha", "alpha", "entropy", "entropy_fraction")
    assert tuple(rows[0]) == list_metrics(losses)
    assert [int(row["frames"]) for row in rows] == [40, 80, 120, 160, 200, 240]
    assert [row["frames"] for row in rows if row["eval/success_rate"]] == ["120", "240"]
    assert all(row["time/mlups"] and row["time/frames_per_second"] for row in rows)
    assert int(rows[-1]["train/updates"]) == (240 - 80) * 0.25
    written = json.loads((folder / "summary.json").read_text())
    assert written.keys() == summary.keys()
    for key in (
        "success_rate",
        "random_success_rate",
        "pursuit_success_rate",
        "intercept_success_rate",
        "mean_return",
        "mean_time_to_success_T",
        "wall_seconds",
        "mlups",
    ):
        assert key in written, key
    assert written["episodes"] == 10
    said = capsys.readouterr().out
    assert [name for name in ("learned", "intercept", "pursuit", "random") if name in said] == [
        "learned",
        "intercept",
        "pursuit",
        "random",
    ]
    assert str(folder / "summary.json") in said


def test_the_same_seed_twice_gives_the_same_metrics_and_another_seed_others(
    toy_config: MakeConfig, tmp_path: Path
) -> None:
    for name, seed in (("first", 3), ("second", 3), ("other", 4)):
        torch.rand(5)  # whatever was drawn before does not matter
        finish(training_of(toy_config(name=name, seed=seed)))
    assert rows_of(tmp_path / "first") == rows_of(tmp_path / "second")
    assert rows_of(tmp_path / "first") != rows_of(tmp_path / "other")


def test_hand_written_fish_that_cannot_be_are_refused_before_anything_is_trained(
    toy_config: MakeConfig, tmp_path: Path
) -> None:
    for name, said in (("randm", "no 'randm'. Did you mean 'random'"), ("pid", "nothing to do in")):
        with pytest.raises(ConfigError, match=f"baselines={name}: .*{said}"):
            training_of(toy_config(baselines=["random", name]))
    assert not list(tmp_path.iterdir())


def test_a_finished_run_is_left_as_it_is_unless_more_is_asked_of_it(
    toy_config: MakeConfig,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    finish(training_of(toy_config(name="run")))
    run = tmp_path / "run"
    summary, settings = (run / "summary.json").read_bytes(), (run / "config.yaml").read_bytes()
    monkeypatch.setattr(sys, "argv", ["train", f"resume={run}", "log_frames=10"])
    main()
    said = f"{run}: already finished; total_frames=... makes it longer"
    assert capsys.readouterr().out.rstrip().endswith(said)
    assert (run / "summary.json").read_bytes() == summary
    assert (run / "config.yaml").read_bytes() == settings
    for more in ("total_frames=480", "final_episodes=4", "baselines=[]", "picture_episodes=2"):
        again = resumed_settings(str(run), [more])
        again.resume = str(run)
        assert not is_over(again)


def test_a_run_that_is_stopped_while_it_draws_is_not_finished(
    toy_config: MakeConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, error, is_there in (
        ("stopped", Interrupted(signal.SIGTERM), False),
        ("failed", OSError("no place for pictures"), True),
    ):
        monkeypatch.setattr("experiments.train.draw", Mock(side_effect=error))
        with pytest.raises(type(error)):
            finish(training_of(toy_config(name=name, picture_episodes=2)))
        assert (tmp_path / name / "summary.json").is_file() == is_there
        assert read_run(tmp_path / name).status == name


KILLED_RUN = """
import json, os, signal, sys
from experiments.settings import TrainConfig
from experiments.train import train
from tests.training.toy_fish import ToyFishEnv, make_toy_env
step, num_steps = ToyFishEnv._step, [0]
def step_or_die(self, td):
    num_steps[0] += self.starts is None  # not of evaluations
    if num_steps[0] == 23:
        os.kill(os.getpid(), signal.SIGKILL)
    return step(self, td)
ToyFishEnv._step = step_or_die
train(TrainConfig(**json.loads(sys.argv[1])), make_env=make_toy_env)
"""


def test_a_run_killed_and_resumed_equals_one_that_was_not(
    toy_config: MakeConfig, tmp_path: Path
) -> None:
    whole = training_of(toy_config(name="whole"))
    whole.run()
    killed = subprocess.run(
        [sys.executable, "-c", KILLED_RUN, json.dumps(vars(toy_config(name="killed")))],
        cwd=ROOT,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        check=False,
        capture_output=True,
    )
    assert killed.returncode == -signal.SIGKILL, killed.stderr.decode()
    rows = rows_of(tmp_path / "killed")
    assert rows[-1]["frames"] == "160"  # killed at frame 184, last checkpoint at frame 160
    resumed = training_of(toy_config(resume=str(tmp_path / "killed")))
    assert resumed.counters.frames == 160
    resumed.run()
    assert rows_of(tmp_path / "killed") == rows_of(tmp_path / "whole")
    theirs = dict(whole.learner.loss.state_dict())
    for name, value in resumed.learner.loss.state_dict().items():
        assert torch.equal(value, theirs[name]), name


def test_rows_after_the_last_checkpoint_are_written_once(
    toy_config: MakeConfig, tmp_path: Path
) -> None:
    config = toy_config(name="run", total_frames=160)
    training_of(config).run()
    before = rows_of(tmp_path / "run")
    with (tmp_path / "run" / "metrics.csv").open("a") as file:
        file.write("200,1,2\n24")  # of a run that went on and was killed while writing
    resumed = training_of(toy_config(resume=str(tmp_path / "run"), total_frames=200))
    resumed.run()
    frames = [row["frames"] for row in rows_of(tmp_path / "run")]
    assert frames == [*(row["frames"] for row in before), "200"]


def test_a_run_made_longer_stays_so_when_it_is_stopped_again(
    toy_config: MakeConfig, tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    training_of(toy_config(name="run", total_frames=80, eval_episodes=2)).run()
    longer = resumed_settings(str(folder), ["total_frames=160"])
    longer.resume = str(folder)
    run_and_stop(training_of(longer), ToyFishEnv, step=3)
    again = resumed_settings(str(folder), [])
    assert (again.total_frames, again.resume) == (160, None)
    again.resume = str(folder)
    training = training_of(again)
    assert training.counters.frames == 104
    training.run()
    assert rows_of(folder)[-1]["frames"] == "160"


def test_settings_noted_on_resume_leave_what_is_of_the_moment(
    toy_config: MakeConfig, tmp_path: Path
) -> None:
    (tmp_path / "given.pt").touch()
    config = toy_config(recognition=str(tmp_path / "given.pt"), live=True)
    folder = begin_run(config, RunFolder.create(parent=str(tmp_path), name="run"))
    note_settings(toy_config(resume=str(folder.path), total_frames=400), folder)
    stored = OmegaConf.load(folder.config)
    assert (stored.total_frames, stored.resume) == (400, None)
    assert (stored.recognition, stored.live) == ("machine.pt", True)


def test_the_collector_goes_on_bit_for_bit(toy_config: MakeConfig) -> None:
    config = toy_config(task={"banned_action": 1})
    first = training_of(config)
    batches = iter(first.collector)
    for _ in range(7):
        next(batches)
    state, rng = first.collector.state_dict(), torch.get_rng_state()
    state = torch.utils._pytree.tree_map(
        lambda x: x.clone() if isinstance(x, torch.Tensor) else x, state
    )
    expected = [next(batches).clone() for _ in range(15)]  # into new episodes and past the warm-up
    second = training_of(config)
    second.collector.load_state_dict(state)
    torch.set_rng_state(rng)
    again = iter(second.collector)
    for batch in expected:
        assert (next(again) == batch).all()
    assert any(bool(batch["next", "done"].any()) for batch in expected)


def test_diverged_transitions_are_counted_and_never_remembered(toy_config: MakeConfig) -> None:
    training = training_of(toy_config(task={"divergence_rate": 0.1}))
    training.run()
    counters, buffer = training.counters, training.learner.buffer
    assert counters.diverged > 5
    assert len(buffer) == counters.frames - counters.diverged
    clean = training_of(toy_config())
    clean.run()
    assert clean.counters.diverged == 0
    assert len(clean.learner.buffer) == clean.counters.frames


def test_warm_up_and_policy_take_legal_actions_only(toy_config: MakeConfig) -> None:
    training = training_of(toy_config(task={"banned_action": 2}))
    training.run()
    actions = training.learner.buffer[:]["action"]
    assert len(actions) == 240
    assert set(actions.tolist()) == {0, 1}


def test_a_state_without_legal_action_is_refused(toy_config: MakeConfig) -> None:
    training = training_of(toy_config())
    batch = next(iter(training.collector)).reshape(-1)
    batch["next", "action_mask"][3] = False
    with pytest.raises(ValueError, match="a state has no legal action"):
        training.learner.remember(batch)


def test_evaluating_on_the_way_does_not_change_what_is_learned(toy_config: MakeConfig) -> None:
    learned = []
    for eval_frames in (8, 240):
        training = training_of(toy_config(eval_frames=eval_frames))
        training.run()
        learned.append(dict(training.learner.loss.state_dict()))
    for name, value in learned[0].items():
        assert torch.equal(value, learned[1][name]), name


def test_the_last_evaluation_is_of_the_best_checkpoint(
    toy_config: MakeConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    training = training_of(toy_config(eval_frames=40))
    num_captures = iter([1, 9, 5, 2, 3, 4, 0, 0, 0, 0])

    def scripted(*args: Any, **kwargs: Any) -> Evaluation:
        captured = torch.arange(10) < next(num_captures)
        nothing = torch.zeros(10)
        return Evaluation(
            succeeded=captured, returns=nothing, lengths_T=nothing, diverged=nothing.bool()
        )

    monkeypatch.setattr(training, "_evaluate", scripted)
    assert training.run()["best_checkpoint_frames"] == 80


def test_the_bar_names_every_phase(toy_config: MakeConfig, monkeypatch: pytest.MonkeyPatch) -> None:
    phases = ["set-up"]
    progress = Progress(is_shown=False)
    rename = progress.rename

    def note(phase: str) -> None:
        if phase != phases[-1]:
            phases.append(phase)
        rename(phase)

    monkeypatch.setattr(progress, "rename", note)
    config = toy_config(compile=True, eval_frames=240)
    finish(set_up(config, make_env=make_toy_env, progress=progress))
    assert phases == [
        "set-up",
        "compilation",
        "warm-up",
        "training",
        "evaluation",
        "training",
        "evaluation",
        "evaluation: learned",
        "evaluation: intercept",
        "evaluation: pursuit",
        "evaluation: random",
    ]


@pytest.mark.learning
def test_the_fish_learns_to_catch_still_food(toy_config: MakeConfig) -> None:
    config = toy_config(
        task={"food_speed_bl": 0.0},
        num_envs=16,
        total_frames=1600,
        warmup_frames=320,
        updates_per_frame=1.0,
        learning_rate=2e-3,
        tau=0.03,
        hidden=[64, 64],
        eval_frames=400,
        eval_episodes=10,
        final_episodes=32,
        algorithm={
            "_target_": "fishrl.training.algorithms.DiscreteSAC",
            "target_entropy_weight": 0.3,
        },
        buffer_size=2000,
        baselines=["random"],
    )
    summary = training_of(config).run()
    # Two seeds gave 29 and 32 captures of 32, the random fish 6.
    assert summary["success_rate"] >= 0.75
    assert summary["random_success_rate"] <= 0.4


def test_run_folder_of_a_second_run_gets_a_number(tmp_path: Path) -> None:
    first = RunFolder.create(parent=str(tmp_path), name="run")
    second = RunFolder.create(parent=str(tmp_path), name="run")
    assert (first.path.name, second.path.name) == ("run", "run-2")


def test_a_toy_env_is_what_the_loop_expects() -> None:
    """The stand-in passes TorchRL's own check, so that a failure here is one of the loop."""
    from torchrl.envs.utils import check_env_specs

    from tests.training.toy_fish import ToyPredation

    env = make_toy_env(task=ToyPredation(), num_envs=3, seed=0)
    assert isinstance(env.base_env, ToyFishEnv)
    check_env_specs(env)
