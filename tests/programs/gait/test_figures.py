"""The figure of a shedding period, in a real flow."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import pytest

from fishrl.envs import KarmanGait, make_env
from fishrl.programs.gait import trials
from fishrl.programs.gait.figures import write_period
from fishrl.training.description import make
from tests.programs.real_wake import gait_settings


def test_a_period_is_drawn_also_if_the_episodes_end_before_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(trials, "make_env", partial(make_env, compile=False))
    monkeypatch.setattr(trials, "START_X_BL", (0.8, 0.9))
    settings = gait_settings(tmp_path)
    settings["stream"]["has_disc"] = False  # no wake to develop
    trial = trials.make_trial("bang_bang", make(settings, kind=KarmanGait), periods=4.0)
    write_period(tmp_path / "period.png", trial, num_decisions=1, periods_T=[0.2])
    assert (tmp_path / "period.png").stat().st_size > 20000
    write_period(tmp_path / "ended.png", trial, num_decisions=18, periods_T=[0.2])
    assert (tmp_path / "ended.png").stat().st_size > 20000
