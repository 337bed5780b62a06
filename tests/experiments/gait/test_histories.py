"""What is kept of the obstacle beside the fish, on kinematic fish."""

from types import SimpleNamespace

import pytest
import torch
from tensordict import TensorDict

import fishrl.envs.task
from experiments.gait.histories import record_histories
from fishrl.envs import KarmanGait, make_env
from tests.envs.conftest import SMALL, kinematic  # noqa: F401 - a fixture
from tests.envs.kinematic_solver import KinematicSolver

LIFT = 0.003  # rho (nodes / step)^2 nodes, on the obstacle of each row times its number


class LiftedSolver(KinematicSolver):
    """An obstacle beside the fish, on which the flow pushes with a constant lift."""

    @property
    def bodies(self) -> list:
        lift = LIFT * torch.arange(1.0, self.num_envs + 1.0).double()
        impulse = torch.stack((0.5 * self.body.age, lift * self.body.age), -1)
        return [self.body, SimpleNamespace(impulse=impulse)]


@pytest.mark.usefixtures("kinematic")
def test_lift_is_the_obstacles_impulse_by_time_in_rho_L_and_T(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(fishrl.envs.task, "InPlaceSolver", LiftedSolver)
    task = KarmanGait(**SMALL | {"wall_margin_bl": 0.25, "time_limit": 12})
    starts = task.sample_starts(2, torch.Generator().manual_seed(0))
    env = make_env(task=task, num_envs=2, starts=starts, frames_per_action=4)

    def cruise(td: TensorDict) -> TensorDict:
        return td.set("action", torch.ones(2, dtype=torch.int64))

    lift = record_histories(env, cruise, starts, num_decisions=2).lift
    unit = task.body_length * (task.body_length / task.scales.period) ** 2
    expected = (LIFT / unit * torch.tensor([[1.0], [2.0]])).double().expand_as(lift)
    assert lift.shape[0] == 2 and lift.shape[1] >= 4
    torch.testing.assert_close(lift, expected)
