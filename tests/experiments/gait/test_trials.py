"""Trials: fixed starts in every flow, and cached histories."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from tensordict.nn import TensorDictModule

import fishrl.envs.flow_env
from experiments.gait import trials
from experiments.gait.trials import Histories, Trial, make_trial, record, run_trial
from fishrl.envs import Flows
from fishrl.envs.changes import StreamSwitches
from fishrl.envs.streams import Stream
from tests.envs.kinematic_solver import KinematicSolver
from tests.experiments.gait.tasks import BRIEF, make_task

pytestmark = pytest.mark.usefixtures("kinematic")

FLOWS = Flows(num_envs=1, compile=False)
LIFT = 0.003  # rho (nodes / step)^2 nodes, on the obstacle of each row times its number


class LiftedSolver(KinematicSolver):
    """Flows that push on the obstacle with a constant lift."""

    def advance_(self, num_steps: int, rows: torch.Tensor | None = None) -> None:
        super().advance_(num_steps, rows)
        fish, disc = self.bodies
        lift = LIFT * torch.arange(1.0, self.num_envs + 1.0).double()
        disc.impulse.copy_(torch.stack((0.5 * fish.age, lift * fish.age), -1))


def test_lift_is_impulse_rate_in_rho_L_and_T(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fishrl.envs.flow_env, "InPlaceSolver", LiftedSolver)
    task = make_task(time_limit=2)
    index = torch.ones(2, dtype=torch.int64)
    trial = Trial(
        name="cruise",
        arm="cruise",
        task=task,
        make_policy=lambda: TensorDictModule(lambda _: index, ["action_mask"], ["action"]),
        identity="",
    )
    starts = task.sample_starts(2, torch.Generator().manual_seed(0))
    lift = record(trial, starts, flows=FLOWS).lift
    unit = task.body_length * (task.body_length / task.scales.period) ** 2
    expected = (LIFT / unit * torch.tensor([[1.0], [2.0]])).double().expand_as(lift)
    assert lift.shape == (2, 2 * trials.FRAMES)
    torch.testing.assert_close(lift, expected)


def test_trials_have_steady_streams_and_fixed_duration() -> None:
    changes = StreamSwitches(interval_T=10.0)
    task = make_task(stream=Stream(has_disc=False, changes=changes))
    assert make_trial("pid", task).task.stream.changes is None
    for time_limit, dt in ((3, 0.25), (900, 0.25), (3, 0.5)):
        task = make_task(
            time_limit=time_limit, control_interval_T=dt, checks_per_action=round(28 * dt)
        )
        tried = make_trial("pid", task).task
        assert 100.0 <= tried.time_limit * tried.interval_T < 100.0 + dt + 0.01


def test_history_follows_its_inputs_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    trial = make_trial("bang_bang", make_task(), periods=BRIEF)
    first = trials.concatenate(run_trial(trial, episodes=1, folder=tmp_path, flows=FLOWS))
    recorded = []

    def pretend(*_: Any, **__: Any) -> Histories:
        recorded.append(None)
        return first

    monkeypatch.setattr(trials, "record", pretend)

    def count(trial: Trial, **settings: Any) -> int:
        for _ in range(2):  # the second time it is read
            again = run_trial(
                trial, **{"episodes": 1, "folder": tmp_path, "flows": FLOWS, **settings}
            )
            for a, b in zip(first, trials.concatenate(again), strict=True):
                torch.testing.assert_close(a, b, rtol=0.0, atol=0.0, equal_nan=True)
        return len(recorded)

    assert count(trial) == 0
    assert count(replace(trial, identity="other weights")) == 1
    assert count(make_trial("bang_bang", make_task(observes=("place",)), periods=BRIEF)) == 2
    assert count(trial, episodes=2) == 3
    monkeypatch.setattr(trials, "hash_sources", lambda *_: "other code")
    assert count(trial) == 4
    for path in tmp_path.glob("histories/*.pt"):
        path.write_bytes(b"not a file")
    with pytest.raises(ValueError, match="cannot be read; delete the file"):
        count(trial)


def test_baselines_beat_at_their_frequency(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rates = torch.tensor([0.001, 0.0012, 0.0014], dtype=torch.float64)
    task = make_task()
    assert task.wakes is not None
    bank = replace(task.wakes, shedding_frequencies=rates)
    monkeypatch.setattr("fishrl.envs.streams.load_wakes", lambda *_: bank)
    task = make_task()
    shed = (rates * task.scales.period).tolist()
    for name, expected in (("passive", [0.0] * 3), ("shedding", shed)):
        trial = make_trial(name, task, periods=BRIEF)
        flows = run_trial(trial, episodes=1, folder=tmp_path, flows=FLOWS)
        assert [float(flow.frequency[0, 0]) for flow in flows] == pytest.approx(expected)
