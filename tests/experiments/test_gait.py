"""From a training with a lateral line to the transfer test, on fish that glide."""

from __future__ import annotations

import csv
import hashlib
import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from experiments import drift_sweep, export_steering, free_stream, gait_page, transfer
from experiments.config import load_config
from experiments.evaluate import evaluate
from experiments.evaluate import main as evaluate_main
from experiments.gait import trials
from experiments.gait.histories import Histories
from experiments.gait.trials import hand_written, load_trial, run_trial
from experiments.settings import ConfigError, EvaluateConfig
from experiments.train import train
from fishrl.envs import KarmanGait, Predation
from fishrl.envs.steering import PolicySteering
from fishrl.envs.streams import Stream
from fishrl.envs.wakes import WakeBank
from fishrl.modules import LateralLineClassifier
from fishrl.training.recognition import Recognition, keep_machine
from tests.envs.conftest import SMALL, gliding  # noqa: F401 - a fixture

pytestmark = pytest.mark.usefixtures("gliding")

SETTINGS = [
    "task=karman_gait",
    "preset=gait_small",
    *(f"task.{name}={value}" for name, value in {**SMALL, "wall_margin_bl": 0.25}.items()),
    "task.time_limit=12",
    "compile=false",
    "num_envs=4",
    "total_frames=48",
    "warmup_frames=16",
    "buffer_size=100",
    "batch_size=8",
    "eval_frames=48",
    "eval_episodes=4",
    "final_episodes=4",
    "hidden=[16]",
]


#: T of a trial.
BRIEF = 2.9


def make_task(**arguments: Any) -> KarmanGait:
    return KarmanGait(**{**SMALL, "wall_margin_bl": 0.25, "time_limit": 12, **arguments})


def make_machine(path: Path, task: KarmanGait | None = None) -> str:
    task = task or make_task()
    machine = LateralLineClassifier(
        flows=task.flow_labels,
        sensors=task.lateral_line_layout,
        generator=torch.Generator().manual_seed(0),
    )
    machine.save(path)
    return str(path)


def run(folder: Path, *overrides: str, **settings: object) -> dict[str, Any]:
    config = load_config("train", [*SETTINGS, f"folder={folder}", *overrides])
    for name, value in settings.items():
        setattr(config, name, value)
    return train(config)


def read_rows(folder: Path) -> list[dict[str, str]]:
    with (folder / "metrics.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    return [{k: v for k, v in row.items() if not k.startswith("time/")} for row in rows]


@pytest.mark.parametrize("who", ["machine", "oracle", "nobody"])
def test_a_gait_is_trained_evaluated_and_tried_in_every_flow(tmp_path: Path, who: str) -> None:
    choice = {"machine": make_machine(tmp_path / "m.pt"), "oracle": "oracle", "nobody": None}[who]
    summary = run(tmp_path, "name=run", f"seed={len(who)}", recognition=choice)
    assert summary["success"] == "survived"
    assert summary["baselines"] == ["pid", "random"]
    assert 0.0 < summary["mean_length_T"] <= 6.0
    assert summary["train_diverged"] == 0
    assert (tmp_path / "run" / "learning_curve.png").is_file()
    assert (tmp_path / "run" / "machine.pt").is_file() == (who == "machine")
    trial = load_trial(tmp_path / "run", periods=BRIEF)
    assert trial.identity != hashlib.sha256(b"").hexdigest()
    arm = {"machine": "both modules", "oracle": "oracle", "nobody": "true row, untold"}[who]
    assert trial.arm == arm
    results = transfer.transfer(
        [trial, hand_written("pid", trial.task, periods=BRIEF)],
        episodes=2,
        folder=tmp_path / "transfer",
    )
    assert list(results["arms"]) == [arm, "pid"]
    flows = results["arms"][arm]
    assert [flow["episodes"] for flow in flows] == [2, 2, 2]
    told = {"oracle": 1.0}.get(who)
    assert told is None or all(flow["named_right"] == told for flow in flows)
    written = {path.name for path in (tmp_path / "transfer").iterdir()}
    assert {"transfer.md", "transfer.json", "survival.png", "paths.png", "work.png"} <= written
    for file in (tmp_path / "run").rglob("*-actor/*"):
        file.write_bytes(b"other weights")
    assert load_trial(tmp_path / "run", periods=BRIEF).identity != trial.identity


def list_learned(folder: Path) -> dict[str, str]:
    """Return what the last row of a run says of its learning."""
    with (folder / "metrics.csv").open(newline="") as file:
        *_, last = csv.DictReader(file)
    return {name: value for name, value in last.items() if name.startswith(("frames", "train/"))}


def test_a_run_with_a_lateral_line_goes_on_exactly(tmp_path: Path) -> None:
    choice = make_machine(tmp_path / "m.pt")
    whole = run(tmp_path, "name=whole", recognition=choice)
    run(tmp_path, "name=part", "total_frames=24", recognition=choice)
    (tmp_path / "m.pt").unlink()
    (tmp_path / "part").rename(tmp_path / "moved")
    config = load_config("train", [*SETTINGS, f"folder={tmp_path}"])
    config.recognition, config.resume = "machine.pt", str(tmp_path / "moved")
    resumed = train(config)
    # the shorter run was evaluated at its end too, and the best of all evaluations is what counts
    assert resumed["updates"] == whole["updates"] > 0
    assert list_learned(tmp_path / "moved") == list_learned(tmp_path / "whole")
    assert read_rows(tmp_path / "moved")[-1] == read_rows(tmp_path / "whole")[-1]


def test_an_evaluation_takes_the_machine_of_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = "task.observes_flow=true"
    run(tmp_path, "name=run", seen, recognition=make_machine(tmp_path / "m.pt"))
    (tmp_path / "m.pt").unlink()
    (tmp_path / "run").rename(tmp_path / "moved")
    saved = tmp_path / "result.json"
    arguments = [f"checkpoint={tmp_path / 'moved'}", "episodes=3", "compile=false", f"save={saved}"]
    monkeypatch.setattr(sys, "argv", ["evaluate", *arguments])
    evaluate_main()
    result = json.loads(saved.read_text())
    assert (result["episodes"], result["task"]) == (3, "KarmanGait")
    config = EvaluateConfig(
        task=load_config("train", [*SETTINGS, seen]).task,
        preset="x",
        checkpoint=str(tmp_path / "moved"),
        episodes=3,
        compile=False,
    )
    with pytest.raises(ValueError, match="num_inputs = 40, here it is 28"):
        evaluate(config)


def test_a_trial_lasts_as_long_however_short_the_episodes_of_learning() -> None:
    for time_limit, dt in ((3, 0.25), (900, 0.25), (3, 0.5)):
        task = make_task(
            time_limit=time_limit, control_interval_T=dt, checks_per_action=round(28 * dt)
        )
        tried = hand_written("pid", task).task
        assert 100.0 <= tried.time_limit * tried.interval_T < 100.0 + dt + 0.01


def test_what_was_swum_is_not_swum_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    trial = hand_written("bang_bang", make_task(), periods=BRIEF)
    first = run_trial(trial, episodes=2, folder=tmp_path)
    monkeypatch.setattr(Recognition, "equip", lambda *_: pytest.fail("swum again"))
    again = run_trial(trial, episodes=2, folder=tmp_path)
    assert all(
        torch.equal(a.nan_to_num(), b.nan_to_num()) for a, b in zip(first, again, strict=True)
    )
    (path,) = tmp_path.glob("*.pt")
    path.write_bytes(b"not a file")
    with pytest.raises(ValueError, match="cannot be read; delete the file"):
        run_trial(trial, episodes=2, folder=tmp_path)


def test_whatever_shapes_a_trial_has_it_swum_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    swum = []

    def pretend(*_: Any, **__: Any) -> Histories:
        swum.append(None)
        return Histories(*(torch.zeros(1) for _ in Histories._fields))

    monkeypatch.setattr(trials, "record_histories", pretend)
    trial = hand_written("bang_bang", make_task(), periods=BRIEF)
    given: dict[str, Any] = {"episodes": 1, "folder": tmp_path}

    def count(trial: trials.Trial, **settings: Any) -> int:
        for _ in range(2):  # the second time it is read
            run_trial(trial, **{**given, **settings})
        return len(swum)

    assert count(trial) == 1
    assert count(replace(trial, identity="other weights")) == 2
    assert count(hand_written("bang_bang", make_task(repeats_frequency=True), periods=BRIEF)) == 3
    assert count(trial, seed=1) == 4
    assert count(trial, episodes=2) == 5
    assert count(trial, samples_actions=True) == 6
    other = tmp_path / "policies.py"
    other.write_text("# other code", encoding="utf-8")
    monkeypatch.setattr(trials.policies, "__file__", str(other))
    assert count(trial) == 7
    assert len(list(tmp_path.glob("*.pt"))) == 7


def test_fish_of_other_tasks_and_unknown_ones_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"behind the \+ may stand policy"):
        hand_written("pid+pd", make_task(), periods=BRIEF)
    with pytest.raises(ConfigError, match="has nothing to do in KarmanGait"):
        run_trial(hand_written("pursuit", make_task(), periods=BRIEF), episodes=1, folder=tmp_path)
    free = make_task(stream=make_task().stream.__class__(has_disc=False))
    with pytest.raises(ConfigError, match="no vortices are shed"):
        hand_written("shedding", free)


def test_recognition_fits_the_task_or_says_why(tmp_path: Path) -> None:
    task = make_task()
    assert Recognition(task, None).task is task
    told = Recognition(task, "oracle")
    assert (told.num_told, told.task.reads_flow_class) == (3, True)
    with pytest.raises(ConfigError, match="Predation has no flows to tell apart"):
        Recognition(Predation(**SMALL), "oracle")
    with pytest.raises(ValueError, match="no such file; train one with"):
        Recognition(task, str(tmp_path / "none.pt"))
    with pytest.raises(ConfigError, match="give oracle, or the machine"):
        keep_machine(str(tmp_path / "none.pt"), tmp_path)
    other = make_task(reynolds=400.0)
    with pytest.raises(ValueError, match="reynolds"):
        Recognition(task, make_machine(tmp_path / "other.pt", other))


def test_trials_that_cannot_be_told_apart_or_compared_are_refused(tmp_path: Path) -> None:
    pid = hand_written("pid", make_task(), periods=BRIEF)
    with pytest.raises(ValueError, match=r"several fish are called \['pid'\]: rename"):
        transfer.transfer([pid, pid], episodes=1, folder=tmp_path)
    other = hand_written("bang_bang", make_task(reynolds=400.0), periods=BRIEF)
    with pytest.raises(ValueError, match=r"bang_bang: its task has reynolds = 400"):
        transfer.transfer([pid, other], episodes=1, folder=tmp_path)


def test_a_passive_fish_never_beats_and_another_beats_with_the_vortices(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rates = torch.tensor([0.001, 0.0012, 0.0014], dtype=torch.float64)
    bank = WakeBank(populations=torch.zeros(3, 1, 1, 1, 1), shedding_frequencies=rates)
    monkeypatch.setattr(Stream, "load_wakes", lambda *_: bank)
    passive = run_trial(
        hand_written("passive", make_task(), periods=BRIEF), episodes=1, folder=tmp_path
    )
    assert passive.frequency.nan_to_num(0.0).abs().max() == 0.0
    trial = hand_written("shedding", make_task(), periods=BRIEF)
    shed = rates * trial.task.scales.period
    with_them = run_trial(trial, episodes=1, folder=tmp_path)
    assert with_them.frequency[:, 0].tolist() == pytest.approx(shed.tolist())


def test_a_fish_may_beat_at_one_rate_whatever_comes(tmp_path: Path) -> None:
    task = make_task()
    beating = run_trial(hand_written("fixed-0.6", task, periods=BRIEF), episodes=1, folder=tmp_path)
    assert beating.frequency[:, 0].tolist() == pytest.approx([0.6] * 3)
    for name, said in (("fixed-x", "give beats per T"), ("fixed-99", "at most .* beats per T")):
        with pytest.raises(ConfigError, match=said):
            hand_written(name, task, periods=BRIEF)


def test_designs_of_the_task_are_compared_by_how_long_the_pid_fish_lasts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pid = hand_written("pid", make_task(), periods=BRIEF)
    results = transfer.transfer([pid], episodes=2, folder=tmp_path / "transfer")
    page = tmp_path / "karman_gait.md"
    page.write_text("a\n<!-- design: begin -->\n<!-- design: end -->\nz\n")
    arguments = ["--docs", str(tmp_path), "--design", f"a=1, b={tmp_path / 'transfer'}"]
    monkeypatch.setattr(sys, "argv", ["gait_page", *arguments])
    gait_page.main()
    lasted = results["arms"]["pid"][0]["survival_T"]
    assert f"| a=1, b | 2 | {lasted:.0f} ± " in page.read_text()


def test_the_programs_say_what_is_wrong_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "argv", ["transfer", str(tmp_path / "none")])
    with pytest.raises(SystemExit, match="error: "):
        transfer.main()
    monkeypatch.setattr(sys, "argv", ["transfer", "--episodes", "0"])
    with pytest.raises(SystemExit, match="error: episodes = 0: must be at least 1"):
        transfer.main()


def test_the_free_stream_is_held_without_a_disc(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(transfer, "load_task", lambda preset, overrides=(): make_task())
    monkeypatch.setattr(free_stream, "load_task", lambda preset, overrides=(): make_task())
    monkeypatch.chdir(tmp_path)  # no trials in a wake lie there
    arguments = ["--episodes", "1", "--periods", "4", "--max-frequency", "2", "--frequency", "1"]
    monkeypatch.setattr(sys, "argv", ["free_stream", *arguments, "--folder", str(tmp_path)])
    free_stream.main()
    result = json.loads((tmp_path / "free_stream.json").read_text())
    assert [row["episodes"] for row in result["flows"]] == [1, 1, 1]
    assert [len(flow["work"]) for flow in result["work"]] == [5, 5, 5]  # at 0 to 4 T
    assert "1.25 L/T:" in capsys.readouterr().out


def test_drift_is_swept_over_frequencies_in_every_stream(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(drift_sweep, "load_task", lambda preset: make_task())
    arguments = ["--frequencies", "0.5", "1", "--starts", "2", "--periods", "3"]
    monkeypatch.setattr(sys, "argv", ["drift_sweep", *arguments, "--folder", str(tmp_path)])
    drift_sweep.main()
    with (tmp_path / "drift.csv").open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if float(row["samples"]) > 0]
    assert {row["stream_speed_bl"] for row in rows} == {"1.0", "1.25", "1.5"}
    # gliding fish swim 0.4 L in a beat, upstream, whatever the stream
    for row in rows:
        expected = -0.4 * float(row["frequency"])
        assert float(row["drift"]) == pytest.approx(expected, abs=0.02)
    facts = json.loads((tmp_path / "drift.json").read_text())
    assert (facts["episodes"], facts["diverged"]) == (12, 0)


def test_fish_of_another_test_stand_below_in_the_tables(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    task = make_task()
    for name in ("pid", "fixed-0.6"):
        trial = hand_written(name, task, periods=BRIEF)
        transfer.transfer([trial], episodes=2, folder=tmp_path / name)
    monkeypatch.setattr(gait_page, "load_trial", lambda run: hand_written("pid", task))
    for name in ("write_period", "list_shedding"):
        monkeypatch.setattr(gait_page, name, lambda *_, **__: [0.5])
    monkeypatch.setattr(gait_page.pictures, "write_training", lambda *_: None)
    page = tmp_path / "page.md"
    page.write_text("<!-- transfer: begin -->\n<!-- transfer: end -->\n")
    gait_page.write_transfer(
        page, tmp_path, tmp_path / "pid", [tmp_path], beside=tmp_path / "fixed-0.6"
    )
    rows = [line.split(" | ")[0] for line in page.read_text().splitlines()]
    assert [rows.count(f"| {name}") for name in ("pid", "fixed-0.6")] == [6, 6]
    assert rows.index("| pid") < rows.index("| fixed-0.6")


def test_a_fish_that_caught_food_becomes_a_helmsman(tmp_path: Path) -> None:
    config = load_config("train", ["preset=small", f"folder={tmp_path}", "name=run"])
    config.task |= SMALL
    config.compile, config.num_envs, config.total_frames, config.warmup_frames = False, 2, 2, 2
    config.eval_episodes = config.final_episodes = 1
    config.picture_episodes, config.baselines = 0, []
    train(config)
    path = tmp_path / "helmsman.pt"
    steering = export_steering.export_steering(tmp_path / "run", path)
    sights = torch.zeros(3, steering.num_stacked, 4, dtype=torch.float64)
    assert steering.turn(sights).shape == (3,)
    run(tmp_path, "name=gait")
    with pytest.raises(ValueError, match="those of a policy trained on Predation"):
        export_steering.export_steering(tmp_path / "gait", tmp_path / "no.pt")
    assert not (tmp_path / "no.pt").exists()


def test_the_helmsman_of_the_package_steers_back_to_the_line() -> None:
    steering = PolicySteering()
    place = torch.tensor([[1.8, 0.6], [1.8, -0.6]], dtype=torch.float64)
    heading = torch.full((2,), torch.pi, dtype=torch.float64)
    sight = steering.look(place, place, heading)
    turn = steering.turn(sight[:, None].expand(-1, steering.num_stacked, -1))
    assert turn[0] > 0.0 > turn[1]  # a heading above pi points down
