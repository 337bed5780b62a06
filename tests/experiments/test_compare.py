"""The comparison of algorithms: equal effort, nothing trained twice, what differences mean."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from experiments import compare as compare_module
from experiments.compare import compare, judge, main, render, summarise
from experiments.interruption import Interrupted
from experiments.settings import ConfigError
from experiments.training import Training
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
    arguments = ["--algorithms", "discrete_sac", "drqn", "--seeds", "0", "1", "--folder"]
    monkeypatch.setattr(sys, "argv", ["compare", *arguments, str(folder), *SETTINGS])

    def stop(*_: Any) -> None:
        raise Interrupted(15)

    with monkeypatch.context() as patch:
        patch.setattr(Training, "_compare", stop)  # of the first run, at its end
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
    assert (folder / "compare.md").read_text() in capsys.readouterr().out
    with Image.open(folder / "compare.png") as picture:
        assert min(picture.size) > 300
    with pytest.raises(ValueError, match=r"was run with total_frames = 16, here it is 32: take"):
        compare(["drqn"], seeds=[0], folder=folder, overrides=[*SETTINGS, "total_frames=32"])
    (folder / "dqn-seed0").mkdir()
    with pytest.raises(ValueError, match="holds no checkpoint; delete it"):
        compare(["dqn"], seeds=[0], folder=folder, overrides=SETTINGS)
    with pytest.raises(ConfigError, match=r"seeds = \[1, 1\]: give one or more different"):
        compare(["dqn"], seeds=[1, 1], folder=folder)


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
