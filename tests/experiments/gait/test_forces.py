"""Forces on a held fish, in a small domain without a developed wake."""

from functools import partial
from math import cos, isfinite, radians

import pytest
import torch

from experiments import gait_forces
from experiments.gait_forces import ForceSettings, find_thrust_phase, hold
from fishrl.envs.streams import Stream
from fishrl.envs.wakes import WakeBank
from fishrl.physics import InPlaceSolver
from fishrl.training.progress import Progress
from tests.experiments.gait.tasks import make_task


def test_the_phase_of_thrust_is_that_of_a_sine_through_the_forces() -> None:
    lags = [radians(angle) for angle in (-110.0, -20.0, 70.0, 160.0)]
    rows = [{"lag": lag, "lock": 1.0, "force_x": 0.01 - 0.05 * cos(lag - 2.0)} for lag in lags]
    assert find_thrust_phase(rows) == pytest.approx(2.0)
    alike = [row | {"lag": 0.1 * row["lag"]} for row in rows]
    assert not isfinite(find_thrust_phase(alike))


def test_a_fish_is_held_at_its_place_for_every_frequency(monkeypatch: pytest.MonkeyPatch) -> None:
    task = make_task(domain_bl=(6.5, 2.5))
    config = task.flow_config()
    bank = WakeBank(
        populations=torch.zeros(3, 1, 9, config.height, config.width),
        shedding_frequencies=torch.full((3,), 2.0 / task.scales.period),
    )
    monkeypatch.setattr(Stream, "load_wakes", lambda *_: bank)
    made = []

    def make(**settings: object) -> InPlaceSolver:
        made.append(partial(InPlaceSolver, compile=False)(**settings))
        return made[-1]

    monkeypatch.setattr(gait_forces, "InPlaceSolver", make)
    few = {"positions_bl": (1.2,), "ratios": (0.0, 1.0), "num_phases": 1, "settling": 1}
    settings = ForceSettings(task=None, periods=2, **few)
    table = hold(task, 1, settings, Progress(is_shown=False))
    assert [row["ratio"] for row in table] == [0.0, 1.0]
    assert all(isfinite(value) for row in table for value in row.values())
    assert not any(row["diverged"] for row in table)
    nose = (made[0].head() - task.origin) / task.body_length
    assert nose[:, 0].tolist() == pytest.approx([1.2, 1.2], abs=0.02)
    assert nose[:, 1].abs().max() < 0.2
