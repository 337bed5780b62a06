"""The figure of a shedding period, in a real flow."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import pytest

from fishrl.envs import KarmanGait, make_env
from fishrl.envs.macro_actions import DirectFrequencies
from fishrl.envs.streams import Stream
from fishrl.programs.gait import figures, trials
from tests.envs.test_real_wake import STREAM, TINY


def test_period_is_drawn_even_if_the_episodes_end_before_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(figures, "make_env", partial(make_env, compile=False))
    monkeypatch.setattr(trials, "START_X_BL", (0.8, 0.9))
    task = KarmanGait(
        **TINY,
        control_interval_T=0.2,  # the stream carries a fish from start to danger in 0.7 T
        start_flows=(0,),
        control=DirectFrequencies(frequencies=(0.5, 1.25, 2.0)),
        stream=Stream(**STREAM, speeds_bl=(1.5,), has_disc=False),  # no wake to develop
    )
    trial = trials.make_trial("bang_bang", task, periods=4.0)
    for name, lead_T in (("period", 0.2), ("ended", 3.0)):
        path = tmp_path / f"{name}.png"
        figures.write_period(path, trial, lead_T=lead_T, periods_T=[0.2])
        assert path.stat().st_size > 20000
