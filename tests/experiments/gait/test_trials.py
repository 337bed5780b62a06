"""Trials: fixed starts in every flow, and histories that are not recorded twice."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from experiments.gait import trials
from experiments.gait.histories import Histories
from experiments.gait.trials import make_trial, run_trial
from fishrl.envs.streams import Stream
from fishrl.envs.wakes import WakeBank
from tests.envs.conftest import kinematic  # noqa: F401 - a fixture
from tests.experiments.gait.tasks import BRIEF, make_task

pytestmark = pytest.mark.usefixtures("kinematic")


def test_a_trial_is_as_long_however_short_the_training_episodes() -> None:
    for time_limit, dt in ((3, 0.25), (900, 0.25), (3, 0.5)):
        task = make_task(
            time_limit=time_limit, control_interval_T=dt, checks_per_action=round(28 * dt)
        )
        tried = make_trial("pid", task).task
        assert 100.0 <= tried.time_limit * tried.interval_T < 100.0 + dt + 0.01


def test_recorded_histories_are_not_recorded_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    trial = make_trial("bang_bang", make_task(), periods=BRIEF)
    first = run_trial(trial, episodes=2, folder=tmp_path)
    monkeypatch.setattr(trials, "record_histories", lambda *_, **__: pytest.fail("run again"))
    again = run_trial(trial, episodes=2, folder=tmp_path)
    assert all(
        torch.equal(a.nan_to_num(), b.nan_to_num()) for a, b in zip(first, again, strict=True)
    )
    (path,) = tmp_path.glob("*.pt")
    path.write_bytes(b"not a file")
    with pytest.raises(ValueError, match="cannot be read; delete the file"):
        run_trial(trial, episodes=2, folder=tmp_path)


def test_whatever_shapes_a_trial_has_it_recorded_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorded = []

    def pretend(*_: Any, **__: Any) -> Histories:
        recorded.append(None)
        return Histories(*(torch.zeros(1) for _ in Histories._fields))

    monkeypatch.setattr(trials, "record_histories", pretend)
    trial = make_trial("bang_bang", make_task(), periods=BRIEF)
    given: dict[str, Any] = {"episodes": 1, "folder": tmp_path}

    def count(trial: trials.Trial, **settings: Any) -> int:
        for _ in range(2):  # the second time it is read
            run_trial(trial, **{**given, **settings})
        return len(recorded)

    assert count(trial) == 1
    assert count(replace(trial, identity="other weights")) == 2
    assert count(make_trial("bang_bang", make_task(repeats_frequency=True), periods=BRIEF)) == 3
    assert count(trial, seed=1) == 4
    assert count(trial, episodes=2) == 5
    assert count(trial, samples_actions=True) == 6
    monkeypatch.setattr(trials, "hash_sources", lambda *_: "other code")
    assert count(trial) == 7
    assert len(list(tmp_path.glob("*.pt"))) == 7


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("pid+pd", r"the only suffix is \+policy"),
        ("fixed-99", "at most .* beats per T"),
        ("shedding", "no vortex shedding"),
    ],
)
def test_baselines_that_cannot_be_are_refused(name: str, message: str) -> None:
    free = make_task(stream=Stream(has_disc=False))
    with pytest.raises(ValueError, match=message):
        make_trial(name, free, periods=BRIEF)


def test_constant_frequencies_are_zero_that_of_the_shedding_or_given(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rates = torch.tensor([0.001, 0.0012, 0.0014], dtype=torch.float64)
    bank = WakeBank(populations=torch.zeros(3, 1, 1, 1, 1), shedding_frequencies=rates)
    monkeypatch.setattr(Stream, "load_wakes", lambda *_: bank)
    passive = run_trial(
        make_trial("passive", make_task(), periods=BRIEF), episodes=1, folder=tmp_path
    )
    assert passive.frequency.nan_to_num(0.0).abs().max() == 0.0
    trial = make_trial("shedding", make_task(), periods=BRIEF)
    shed = rates * trial.task.scales.period
    with_them = run_trial(trial, episodes=1, folder=tmp_path)
    assert with_them.frequency[:, 0].tolist() == pytest.approx(shed.tolist())
    beating = run_trial(
        make_trial("fixed-0.6", make_task(), periods=BRIEF), episodes=1, folder=tmp_path
    )
    assert beating.frequency[:, 0].tolist() == pytest.approx([0.6] * 3)
