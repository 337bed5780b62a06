"""Runs begin, end, are killed, and resume exactly."""

import signal
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from fishrl.envs import FlowEnv, Flows, Predation
from fishrl.training import (
    Algorithm,
    Callback,
    DiscreteSAC,
    LearningSettings,
    RunSettings,
    complete,
    open_run,
    resume,
    train,
)
from fishrl.training.algorithms.dqn import DQN
from fishrl.training.algorithms.drqn import DRQN
from fishrl.training.algorithms.ppo import PPO
from fishrl.training.algorithms.sac import SAC
from fishrl.training.logger import CsvLogger
from fishrl.training.loop import Training
from fishrl.training.run_folder import read_config, write_yaml
from tests.envs.test_real_flow import TINY
from tests.training.conftest import QUICK, Toy, assert_equal_weights, make_toy_plan, read_rows
from tests.training.stops import run_and_kill, run_and_stop
from tests.training.toy_fish import ToyFishEnv, ToyPredation


def test_run_in_real_flow_resumes_exactly_amid_episodes(tmp_path: Path) -> None:
    few = {"total_frames": 12, "warmup_frames": 4, "buffer_size": 8, "log_frames": 2}
    few |= {"checkpoint_frames": 2, "eval_frames": 12, "batch_size": 4}
    few |= {"flows": Flows(num_envs=2, compile=False)}
    task = Predation(**TINY, control_interval_T=0.25, checks_per_action=6, time_limit=3)

    def start(name: str) -> Training:
        plan = make_toy_plan(tmp_path, name=name, **QUICK | few | {"eval_episodes": 1})
        return Training(open_run(replace(plan, task=task)))

    whole = start("whole")
    whole.run()
    part = start("part")
    run_and_stop(part, FlowEnv, step=4)
    assert (part.collector.env.base_env.solver.body.age > 0).all()
    part.close()
    resumed = start("part")
    assert resumed.counters.frames == 8
    resumed.run()
    assert read_rows(tmp_path / "part") == read_rows(tmp_path / "whole")
    assert_equal_weights(resumed, whole)


def test_run_resumed_after_sigkill_equals_an_uninterrupted_run(toy: Toy, whole: Training) -> None:
    run_and_kill(toy.folder, step=23)
    assert toy.rows("run")[-1]["frames"] == "160"  # killed at 184, last checkpoint at 160
    resumed = toy.reopen("run")
    assert resumed.counters.frames == 160
    resumed.run()
    assert toy.rows("run") == read_rows(whole.folder.path)
    assert_equal_weights(resumed, whole)


class Counts(Callback):
    """Where each progress bar ends."""

    def __init__(self) -> None:
        self.counts: list[int] = []

    def on_phase(self, phase: str, *, total: int | None = None, done: int = 0) -> None:
        if total is not None:
            self.counts.append(done)

    def on_progress(self, amount: int, *_: Any) -> None:
        self.counts[-1] += amount


@pytest.mark.parametrize(
    ("step", "frames"), [(7, 56), (23, 184), (3, 120)], ids=["warm-up", "learning", "evaluating"]
)
def test_resumes_exactly_after_a_signal(toy: Toy, whole: Training, step: int, frames: int) -> None:
    is_late = step == 3  # of the evaluation at frame 120
    part = toy.begin(name="part", **QUICK)
    run_and_stop(part, ToyFishEnv, step=step, evaluating=is_late)
    resumed = toy.reopen("part")
    assert resumed.counters.frames == frames
    assert bool(resumed.counters.pending) == is_late
    resumed.callbacks = shown = Counts()
    resumed.run()
    assert shown.counts[0] == 240
    assert toy.rows("part") == read_rows(whole.folder.path)
    assert_equal_weights(resumed, whole)


#: Algorithms, and the gradient steps of each in 240 frames of 8 flows, 80 of them warm-up.
ALGORITHMS: list[tuple[Algorithm, float]] = [
    (DiscreteSAC(), (240 - 80) * 0.25),
    (DQN(epsilon_frames=60), (240 - 80) * 0.25),
    (DRQN(sequence_length=4, epsilon_frames=60), (240 - 80) * 0.25),
    (SAC(), (240 - 80) * 0.25),
    # 3 rollouts of 4 batches each, 4 times; 160 frames are 2 rollouts and 2 decisions
    (PPO(rollout_length=9, num_epochs=4), 3 * 4 * 4),
]


@pytest.mark.parametrize(
    ("algorithm", "num_updates"), ALGORITHMS, ids=lambda a: getattr(a, "label", "")
)
def test_algorithms_resume_exactly(toy: Toy, algorithm: Algorithm, num_updates: float) -> None:
    legal = {"is_continuous": True} if isinstance(algorithm, SAC) else {"banned_action": 1}
    can_more = isinstance(algorithm, DiscreteSAC)
    settings: dict[str, Any] = {
        "task": {
            "divergence_rate": 0.03,
            "critic_observes": ("heading",) if can_more else (),
            **legal,
        },
        "reflect": can_more,
        "critic_frames": 100 if can_more else 0,  # the last round before it is frame 176
        "algorithm": algorithm,
        "batch_size": 18 if isinstance(algorithm, PPO) else 64,
        "buffer_size": 130,  # the oldest are forgotten on the way
        "eval_frames": 80,  # all choose the best among the same
        "actor_average": 100,
        "scale_inputs": True,
        **QUICK,
    }
    whole = toy.begin(name="whole", **settings)
    summary = whole.run()
    assert (summary["frames"], summary["updates"]) == (240, num_updates)
    assert summary["train_diverged"] > 0
    taken = whole.learner.buffer[:]["action"]
    if isinstance(algorithm, PPO):
        assert 60 < len(taken) < 8 * 9  # without those that diverged
    if isinstance(algorithm, SAC):
        assert taken.abs().max() <= 1.0
    else:
        assert set(taken.tolist()) == {0, 2}
    toy.begin(name="part", **settings | {"total_frames": 160}).run()
    resumed = toy.reopen("part", total_frames=240)
    assert resumed.counters.frames == 160
    resumed.run()
    assert toy.rows("part")[-1] == toy.rows("whole")[-1]
    assert_equal_weights(resumed, whole)
    mine, other = (t.learner.explorer.state_dict() for t in (resumed, whole))
    assert all(torch.equal(value, other[key]) for key, value in mine.items())


def test_resume_stores_changes_and_keeps_entries_of_programs(toy: Toy) -> None:
    config = toy.folder / "run" / "config.yaml"
    toy.begin(name="run", total_frames=80, **QUICK).run()
    write_yaml(config, read_config(config) | {"picture_episodes": 6})
    run_and_stop(toy.reopen("run", total_frames=160), ToyFishEnv, step=3)
    stored = read_config(config)
    assert (stored["total_frames"], stored["picture_episodes"]) == (160, 6)
    assert stored["flows"]["num_envs"] == 8
    assert toy.reopen("run").run()["frames"] == 160
    for wrong in ({"gamma": 0.9}, {"flows": Flows(num_envs=4)}, {"total_frame": 200}):
        with pytest.raises(ValueError, match=r"is fixed in a run|did you mean 'total_frames'"):
            toy.reopen("run", **wrong)


def test_resume_leaves_a_finished_run_unchanged_unless_extended(toy: Toy) -> None:
    out_of_reach = {"capture_radius_bl": 1e-9}
    result = toy.begin(name="run", total_frames=16, task=out_of_reach, **QUICK).run()
    toy.trainings[-1].close()
    run, plan = toy.folder / "run", toy.trainings[-1].plan
    assert resume(run) == result
    before = {path.name: path.read_bytes() for path in run.iterdir() if path.is_file()}
    for harmless in ({}, {"log_frames": 10}, {"total_frames": 8}):
        assert resume(run, **harmless)["frames"] == 16
    assert before == {path.name: path.read_bytes() for path in run.iterdir() if path.is_file()}
    for more in ({"total_frames": 48}, {"final_episodes": 4}, {"baselines": ("random",)}):
        assert open_run(plan.change(**more)).checkpoint is not None
    assert resume(run, final_episodes=4)["episodes"] == 4


class Spare(CsvLogger):
    """Another logger."""


def test_training_named_run_again_continues_or_returns_summary(toy: Toy) -> None:
    phases: list[str] = []

    class Phases(Callback):
        def on_phase(self, phase: str, **_: Any) -> None:
            phases.append(phase)

    def run(total_frames: int) -> dict[str, Any]:
        phases.clear()
        few: dict[str, Any] = QUICK | {"folder": str(toy.folder)}
        return train(
            task=ToyPredation(),
            learning=LearningSettings(
                flows=Flows(num_envs=8), warmup_frames=80, updates_per_frame=0.1
            ),
            run=RunSettings(name="run", total_frames=total_frames, **few),
            callbacks=[Phases()],
        )

    first, again = run(160), run(160)
    assert again["frames"] == 160 and again["mean_return"] == first["mean_return"]
    assert phases == []
    assert run(240)["frames"] == 240 and "warm-up" not in phases  # continued, not begun
    assert [path.name for path in toy.folder.iterdir()] == ["run"]
    toy.begin(name="other", logger=Spare(), **QUICK)
    again = make_toy_plan(toy.folder, name="other", **QUICK)
    assert isinstance(open_run(again).plan.logger, Spare)  # it keeps its logger
    assert type(open_run(again.change(logger=CsvLogger())).plan.logger) is CsvLogger


def test_run_without_its_checkpoint_is_not_resumed(toy: Toy) -> None:
    training = toy.begin(name="run", total_frames=16, **QUICK)
    training.run()
    (toy.folder / "run" / "checkpoints").rename(toy.folder / "elsewhere")
    (toy.folder / "run" / "summary.json").unlink()
    with pytest.raises(ValueError, match="there is none"):
        toy.reopen("run")


def test_damaged_checkpoint_is_noticed_first(toy: Toy, monkeypatch: pytest.MonkeyPatch) -> None:
    toy.begin(name="run", total_frames=16, **QUICK).run()
    (toy.folder / "run" / "summary.json").unlink()
    monkeypatch.setattr(Training, "_set_up", lambda _: pytest.fail("set up"))
    *_, state = sorted((toy.folder / "run" / "checkpoints" / "last").rglob("state.pt"))
    state.write_bytes(state.read_bytes()[:-1])
    with pytest.raises(ValueError, match=rf"{state.parent.name}/state.pt has changed"):
        toy.reopen("run")


def test_older_checkpoint_replaces_a_corrupt_one(toy: Toy) -> None:
    toy.begin(name="run", keep_checkpoints=3, **QUICK).run()
    folder = toy.folder / "run" / "checkpoints"
    names = sorted(path.name for path in folder.iterdir())
    assert names == ["best", "last", "last-000000080", "last-000000160"]
    (folder / "last" / "manifest.json").write_text("{")
    (toy.folder / "run" / "summary.json").unlink()
    with pytest.raises(ValueError, match="or delete it, and last-000000160 takes its place"):
        toy.reopen("run")
    (folder / "last").rename(toy.folder / "broken")
    assert toy.reopen("run").counters.frames == 160


@pytest.mark.parametrize("losses", [[15, 30], [3, 3]])
def test_lost_worker_restarts_once_per_checkpoint(
    toy: Toy, whole: Training, monkeypatch: pytest.MonkeyPatch, losses: list[int]
) -> None:
    step, restore, left = ToyFishEnv._step, ToyFishEnv.set_extra_state, list(losses)
    training = toy.begin(name="run", **QUICK)
    num_steps, before, handlers = 0, signal.getsignal(signal.SIGTERM), set()

    def step_or_lose(self: ToyFishEnv, td: Any) -> Any:
        nonlocal num_steps
        num_steps += 1
        handlers.add(signal.getsignal(signal.SIGTERM))
        if left and num_steps == left[0]:
            num_steps = 0
            left.pop(0)
            raise ChildProcessError("a flow worker failed")
        return step(self, td)

    def restore_and_watch(self: ToyFishEnv, state: Any) -> None:
        handlers.add(signal.getsignal(signal.SIGTERM))
        restore(self, state)

    monkeypatch.setattr(ToyFishEnv, "_step", step_or_lose)
    monkeypatch.setattr(ToyFishEnv, "set_extra_state", restore_and_watch)
    if losses[-1] > 3:
        complete(training)
    else:
        with pytest.raises(ChildProcessError, match="a flow worker failed"):
            complete(training)
        assert (toy.folder / "run" / "failure.txt").is_file()
        monkeypatch.undo()
        resume(toy.folder / "run")
    assert not left
    assert toy.rows("run") == read_rows(whole.folder.path)
    assert len(handlers) == 1 and before not in handlers  # a signal waits for the next step
    assert signal.getsignal(signal.SIGTERM) is before
    assert not (toy.folder / "run" / "failure.txt").exists()
