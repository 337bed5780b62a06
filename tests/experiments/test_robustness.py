"""Policies tried under other conditions: what is changed, paired intervals, the whole once."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from experiments import robustness
from experiments.robustness import CONDITIONS, list_trials, vary
from fishrl.envs import KarmanGait
from fishrl.modules import LateralLineClassifier
from fishrl.programs.gait.trials import load_trial, make_trial
from fishrl.programs.statistics import compare_paired
from fishrl.programs.train_settings import TRAINING
from fishrl.training.description import make, to_plain

POLICY = Path("zoo/gait_small_ablation")


def flatten(settings: Any, path: str = "") -> dict[str, str]:
    """Return nested settings by their path."""
    if not isinstance(settings, dict):
        return {path: str(settings)}
    parts = (flatten(value, f"{path}.{name}") for name, value in settings.items())
    return {key: value for part in parts for key, value in part.items()}


def test_a_condition_changes_its_setting_alone() -> None:
    trial = load_trial(POLICY, periods=2.0)
    before = flatten(to_plain(trial.task))
    for changes in CONDITIONS.values():
        after = flatten(to_plain(vary(trial, changes).task))
        assert dict(after.items() - before.items()) == flatten(to_plain(changes))
        assert after.keys() == before.keys()
    wide = vary(trial, {"stream": {"diameter_bl": 0.6}})
    assert wide.task.stream.diameter_bl == 0.6
    assert wide.task.stream.speeds_bl == trial.task.stream.speeds_bl
    with pytest.raises(ValueError, match="diametre_bl"):
        vary(trial, {"stream": {"diametre_bl": 0.6}})


def test_a_policy_of_several_discs_and_baselines_get_the_row_of_the_nearest_stream() -> None:
    settings = TRAINING.read(["preset=gait_varied"])
    task = make(settings.task, kind=KarmanGait)
    own = make_trial("pid", task, periods=2.0)
    assert task.scales == load_trial(POLICY, periods=2.0).task.scales
    for changes, flows in (
        ({}, (1, 5, 9)),
        ({"stream": {"diameter_bl": 0.5}}, (2, 6, 10)),
        ({"stream": {"speeds_bl": (0.8, 1.7), "diameter_bl": (0.25, 0.6)}}, (0, 11)),
    ):
        trials = list_trials([own], ["pid"], {**changes, "start_y_bl": (0.3, 0.6)}, periods=2.0)
        for trial in trials:
            assert trial.task.control.rows == tuple(task.control.rows[flow] for flow in flows)
            assert trial.task.start_flows == tuple(range(len(flows)))
            assert (trial.task.start_y_bl, trial.task.lateral_line.noise) == ((0.3, 0.6), 0.0)
        assert tuple(map(tuple, trials[1].make_policy().rows.tolist())) == trial.task.control.rows
    with pytest.raises(ValueError, match="tasks differ in body_length"):
        list_trials([own, load_trial(Path("zoo/gait_narrow"))], [], {}, periods=100.0)
    machine = LateralLineClassifier(flows=task.flow_labels, sensors=task.lateral_line_layout)
    with pytest.raises(ValueError, match="give runs without a classifier"):
        vary(replace(own, recognition=machine), {})


def test_differences_are_paired_by_start() -> None:
    draw = np.random.default_rng(1)
    theirs = 100.0 * draw.random((3, 40))  # starts that differ far more than the policies
    theirs[:] = theirs[0]
    found = compare_paired(theirs + 1.0, theirs)
    assert (found.value, found.low, found.high) == pytest.approx((1.0, 1.0, 1.0))


@pytest.mark.parametrize("shape", [(1, 60), (1, 4), (3, 4)], ids=str)
def test_an_interval_covers_the_difference_as_often_as_it_says(shape: tuple[int, int]) -> None:
    draw = np.random.default_rng(2)
    hits = 0
    for _ in range(200):
        seeds = draw.normal(size=(2, shape[0], 1)) * (shape[0] > 1)  # policies differ, too
        noise = seeds + draw.normal(size=(2, *shape))
        found = compare_paired(2.0 + noise[0], noise[1])
        hits += found.low <= 2.0 <= found.high
    assert 180 <= hits <= (200 if shape[0] > 1 else 198)


def test_one_start_gives_no_interval() -> None:
    assert compare_paired(np.array([[2.0]]), np.array([[1.0]])).show("+.1f") == "+1.0"


def test_a_reference_that_is_not_tried_is_refused() -> None:
    with pytest.raises(ValueError, match="reference"):
        robustness.main.run(robustness.main.read([f"runs=[{POLICY}]", "reference=oracle"]))
