"""The comparison of algorithms: equal effort, nothing trained twice, what differences mean."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from experiments import compare as compare_module
from experiments.compare import compare, judge, main, read_arguments, render, summarise
from experiments.config import load_config
from experiments.settings import ConfigError, TrainConfig
from experiments.train import begin_run
from fishrl.training.interruption import Interrupted
from fishrl.training.run_folder import RunFolder
from tests.docs.pages import DOCS
from tests.envs.conftest import SMALL, gliding  # noqa: F401 - a fixture

SETTINGS = [
    *(f"task.{name}={value}" for name, value in SMALL.items()),
    *("compile=false", "num_envs=2", "total_frames=16", "warmup_frames=4", "hidden=[8]"),
    *("updates_per_frame=0.5", "eval_frames=8", "eval_episodes=2", "final_episodes=2"),
    *("buffer_size=50", "batch_size=8", "baselines=[random]"),
]


@pytest.mark.usefixtures("gliding")
def test_algorithms_are_trained_once_and_compared(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "compare"
    arguments = ["--folder", str(folder), "--algorithms", "discrete_sac", "drqn", "--seeds", "0"]
    monkeypatch.setattr(sys, "argv", ["compare", *arguments, "1", *SETTINGS])

    def stop(*_: Any) -> None:
        raise Interrupted(15)

    with monkeypatch.context() as patch:
        patch.setattr("fishrl.training.loop.summarize", stop)  # of the first run, at its end
        with pytest.raises(SystemExit, match="143"):
            main()
    assert "SIGTERM: saved; the same command goes on" in capsys.readouterr().err
    main()
    monkeypatch.setattr(compare_module, "set_up", lambda *_, **__: pytest.fail("trained again"))
    main()
    result = json.loads((folder / "compare.json").read_text())
    assert (result["frames"], result["updates"], result["num_seeds"]) == (16, 6, 2)
    assert list(result["algorithms"]) == ["discrete_sac", "drqn"]
    assert list(result["baselines"]) == ["random"]
    again = json.loads((folder / "discrete_sac-seed1" / "summary.json").read_text())
    assert again["baselines"] == []  # they swim the same whatever is learned
    assert (folder / "compare.md").read_text() in capsys.readouterr().out
    with Image.open(folder / "compare.png") as picture:
        assert min(picture.size) > 300
    with pytest.raises(ValueError, match=r"was run with total_frames = 16, here it is 32: take"):
        compare(["drqn"], seeds=[0], folder=folder, overrides=[*SETTINGS, "total_frames=32"])
    with pytest.raises(ConfigError, match=r"seeds = \[1, 1\]: give one or more different"):
        compare(["dqn"], seeds=[1, 1], folder=folder)


def read_documented_line() -> list[str]:
    page = (DOCS / "algorithms.md").read_text(encoding="utf-8")
    (line,) = (line for line in page.splitlines() if "-m experiments.compare" in line)
    return line.split()[3:]


def test_the_line_of_the_page_is_read() -> None:
    options = read_arguments(read_documented_line())
    assert options.seeds == [0, 1, 2, 3, 4]
    assert options.settings == ["preset=quick", "eval_frames=350"]
    assert options.docs is None


def test_the_page_takes_table_and_curves(tmp_path: Path) -> None:
    (tmp_path / "figures").mkdir()
    page = tmp_path / "algorithms.md"
    page.write_text("a\n<!-- compare: begin -->\nold\n<!-- compare: end -->\nz\n")
    (tmp_path / "compare.md").write_text("| new |\n")
    (tmp_path / "compare.png").write_bytes(b"picture")
    compare_module.write_page(tmp_path, tmp_path)
    assert page.read_text() == "a\n<!-- compare: begin -->\n| new |\n<!-- compare: end -->\nz\n"
    assert (tmp_path / "figures" / "compare.png").read_bytes() == b"picture"


def test_the_line_of_the_page_means_all_algorithms() -> None:
    options = read_arguments(read_documented_line())
    assert options.algorithms == list(compare_module.ALGORITHMS)


@pytest.mark.parametrize(
    "line",
    [
        "preset=small num_envs=3 --algorithms dqn drqn --seeds 0 1 --folder runs/a=b",
        "--folder runs/a=b --seeds 0 1 preset=small --algorithms dqn drqn num_envs=3",
        "preset=small --algorithms dqn drqn --folder=runs/a=b num_envs=3 --seeds 0 1",
    ],
)
def test_settings_may_stand_before_between_and_behind_the_options(line: str) -> None:
    options = read_arguments(line.split())
    assert (options.algorithms, options.seeds) == (["dqn", "drqn"], [0, 1])
    assert (options.settings, options.folder) == (["preset=small", "num_envs=3"], Path("runs/a=b"))


def test_a_word_that_is_no_setting_is_left_to_the_settings() -> None:
    assert read_arguments(["small", "--seeds", "0"]).settings == ["small"]


@pytest.mark.parametrize("words", [["--config-dir", "{}"], ["--config-dir={}"]])
def test_a_folder_of_configuration_is_taken_as_by_a_training(
    tmp_path: Path, words: list[str]
) -> None:
    (tmp_path / "preset").mkdir()
    (tmp_path / "preset" / "mine.yaml").write_text("# @package _global_\npreset: mine\nseed: 7\n")
    line = ["--seeds", "0", *(word.format(tmp_path) for word in words), "preset=mine"]
    assert load_config("train", read_arguments(line).settings).seed == 7


def begin_alone(begun: list[str | None]) -> Callable[..., Any]:
    """Return a ``set_up`` that is ended before the first frame, and notes what goes on."""

    def set_up(config: TrainConfig, **_: Any) -> None:
        begun.append(config.resume)
        if config.resume is None:
            begin_run(config, RunFolder.create(parent=config.folder, name=str(config.name)))
        raise Interrupted(15)

    return set_up


def test_a_run_that_was_ended_before_its_first_checkpoint_is_started_by_the_same_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun: list[str | None] = []
    monkeypatch.setattr(compare_module, "set_up", begin_alone(begun))
    for _ in range(2):
        with pytest.raises(Interrupted):
            compare(["dqn"], seeds=[0], folder=tmp_path)
    (tmp_path / "drqn-seed0").mkdir()  # ended before it wrote its settings
    with pytest.raises(Interrupted):
        compare(["drqn"], seeds=[0], folder=tmp_path)
    assert (tmp_path / "drqn-seed0" / "config.yaml").is_file()
    assert begun == [None, str(tmp_path / "dqn-seed0"), str(tmp_path / "drqn-seed0")]
    (tmp_path / "double_dqn-seed0" / "checkpoints" / "last").mkdir(parents=True)
    with pytest.raises(ValueError, match=r"no config\.yaml; delete it, or take another --folder"):
        compare(["double_dqn"], seeds=[0], folder=tmp_path)


def test_the_same_machine_goes_on_and_another_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun: list[str | None] = []
    monkeypatch.setattr(compare_module, "set_up", begin_alone(begun))
    machine = tmp_path / "given.pt"
    machine.write_bytes(b"1")
    for _ in range(2):
        with pytest.raises(Interrupted):
            compare(["dqn"], seeds=[0], folder=tmp_path, overrides=[f"recognition={machine}"])
    assert begun == [None, str(tmp_path / "dqn-seed0")]
    machine.write_bytes(b"2")
    with pytest.raises(ValueError, match=r"was run with recognition = .*machine\.pt.*given\.pt"):
        compare(["dqn"], seeds=[0], folder=tmp_path, overrides=[f"recognition={machine}"])


def test_what_is_logged_and_saved_may_differ_from_the_runs_that_are_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun: list[str | None] = []
    monkeypatch.setattr(compare_module, "set_up", begin_alone(begun))
    for given in ("log_frames=16", "log_frames=32"):
        with pytest.raises(Interrupted):
            compare(["dqn"], seeds=[0], folder=tmp_path, overrides=[given])
    assert begun == [None, str(tmp_path / "dqn-seed0")]


def run_of(rates: list[float], **summary: Any) -> dict[str, Any]:
    frames = np.arange(1, len(rates) + 1) * 100.0
    known = {"frames": 300, "updates": 40, "success_rate": rates[-1], "mean_return": 1.0}
    curve = (frames, np.array(rates))
    return {
        "summary": {**known, "baselines": ["pursuit"], "pursuit_success_rate": 0.9, **summary},
        "curves": {"eval/success_rate": curve, "eval/mean_return": curve},
    }


def test_speed_is_the_mean_of_the_curve_and_differences_have_intervals() -> None:
    runs = {
        "discrete_sac": [run_of([0.2, 0.8, 1.0]), run_of([0.4, 0.6, 0.8]), run_of([0.6, 0.6, 0.6])],
        "dqn": [run_of([0.0, 0.1, 0.2]), run_of([0.0, 0.0, 0.0]), run_of([0.0, 0.0, 0.6])],
    }
    result = summarise(runs)
    speed = result["algorithms"]["discrete_sac"]["speed"]
    # three speeds 2/3, 0.6, 0.6: Student's t for 2 degrees of freedom is 4.303
    assert speed[0] == pytest.approx(1.8667 / 3, abs=1e-4)
    assert speed[1] == pytest.approx(4.303 * np.std([2 / 3, 0.6, 0.6], ddof=1) / 3**0.5, rel=1e-3)
    assert result["algorithms"]["dqn"]["frames_to_half"] == [None, None, 300.0]
    assert judge(result["differences_of_speed"]["dqn"]) == "faster"
    table = render(result)
    assert "| dqn | 0.10 ±" in table and "300 frames, 1 of 3 seeds" in table
    assert "| pursuit (hand-written) | | 0.90 | | |" in table


def test_a_difference_within_its_interval_decides_nothing() -> None:
    assert judge([0.1, 0.2]) == "undecided"
    assert judge([0.1, None]) == "undecided"
    assert judge([-0.3, 0.2]) == "slower"


def test_runs_of_unequal_effort_are_not_compared() -> None:
    runs = {"a": [run_of([0.1])], "b": [run_of([0.1], updates=41)]}
    with pytest.raises(ValueError, match=r"\(300, 40\), \(300, 41\)\]; compare runs of equal"):
        compare_module._check_effort(runs)
