"""Policies tried in changing streams: what counts as recognised, and the whole on gliding fish."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
import torch

from experiments import changing_streams, following, robustness
from experiments.changing_streams import Record, find_delays, tabulate
from fishrl.envs import KarmanGait
from fishrl.envs.changes import StreamSteps
from fishrl.envs.macro_actions import DirectFrequencies
from fishrl.envs.streams import Stream
from fishrl.modules import LateralLineClassifier
from fishrl.programs.gait.trials import load_trial
from fishrl.programs.program import Program
from fishrl.programs.statistics import half_width
from tests.envs.conftest import SMALL

PROGRAMS = (changing_streams, following, robustness)
TWICE = "zoo/gait_small,zoo/gait_small"


def make_record(named: list[int], length_T: float) -> Record:
    """Return an episode of half a T per decision."""
    time, row = 0.5 * torch.arange(1, 25), torch.tensor(named + [1] * 4).double()[None]
    never = torch.zeros(1, dtype=torch.bool)
    return Record(time, row, row, row, row, torch.tensor([length_T]), never)


@pytest.mark.parametrize(("length_T", "num"), [(12.0, 2), (9.9, 1)])
def test_a_change_is_recognised_with_the_first_right_label_after_it_began(
    length_T: float, num: int
) -> None:
    changes = StreamSteps(times_T=(4.0, 8.0, 10.0), speeds_bl=(1.5, 1.0, 1.1))
    stream = Stream(changes=changes)
    task = KarmanGait(**SMALL | {"wall_margin_bl": 0.25}, stream=stream, start_flows=(1,))
    # labels: 1, from 4 T on 2, from 8 T on 0, and at 10 T no other one
    named = [1, 1, 1, 2, 1, 1, 1, 1, 1, 1, 0, 2, 2, 0, 2, 2, 2, 2, 1, 1]
    delays = find_delays(make_record(named, length_T), task)
    assert delays == [2.0, math.inf][:num]


def test_labels_of_other_discs_are_no_candidates() -> None:
    changes = StreamSteps(times_T=(4.0,), speeds_bl=(1.5,))
    speeds, sizes = (1.0, 1.5, 1.0, 1.5), (0.4, 0.4, 0.5, 0.5)
    stream = Stream(changes=changes, speeds_bl=speeds, diameter_bl=sizes)
    given = SMALL | {"wall_margin_bl": 0.25, "control": DirectFrequencies(frequencies=(0.5, 1.0))}
    task = KarmanGait(**given, stream=stream, start_flows=(2,))
    assert find_delays(make_record([2] * 9 + [3] * 11, 12.0), task) == [1.0]


def test_a_policy_takes_another_classifier(tmp_path: Path) -> None:
    own = load_trial(Path("zoo/gait_small")).recognition
    assert isinstance(own, LateralLineClassifier)
    own.save(tmp_path / "other.pt")
    for given in (str(tmp_path / "other.pt"), "zoo/gait_small"):
        trial = load_trial(Path("zoo/gait_small_oracle"), recognition=given)
        assert trial.arm == "both modules"
        assert isinstance(trial.recognition, LateralLineClassifier)


@pytest.mark.parametrize(
    ("main", "runs"),
    [(changing_streams.main, ""), *((program.main, TWICE) for program in PROGRAMS)],
)
def test_policies_are_needed_all_of_different_names(main: Program, runs: str) -> None:
    with pytest.raises(ValueError, match="all of different names"):
        main.run(main.read([f"runs=[{runs}]"]))


def test_the_interval_of_survival_is_over_policies_where_there_are_several() -> None:
    numbers = {"accuracy": math.nan, "diverged": 0, "survival_T": [10.0, 10.0, 20.0, 20.0]}
    several, one = (
        tabulate({"a": {**numbers, "survival_by_policy_T": means}}) for means in ([10, 20], [15])
    )
    assert f"15.0 ± {half_width([10, 20]):.1f}" in several
    assert f"15.0 ± {half_width(numbers['survival_T']):.1f}" in one
