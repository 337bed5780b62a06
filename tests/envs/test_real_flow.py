"""The environment on the real flow: small and for few actions, so the physics is not accurate."""

from math import degrees, pi

import pytest
import torch

from fishrl.envs import Predation
from fishrl.envs.control import Bend
from tests.envs.conftest import SMALL, act, make_flows

#: A tank of 5 L x 3 L, where an eager action takes about a second.
TINY = SMALL | {
    "body_length": 16,
    "wall_margin_bl": 0.18,
    "domain_bl": (5.0, 3.0),
    "start_x_bl": (2.5, 3.5),
    "food_x_bl": 1.0,
    "food_y_bl": 1.5,
    "food_limits_bl": (1.0, 2.0),
}


def test_fish_swims_and_turns_as_commanded() -> None:
    env = make_flows(Predation(**TINY), 1, seed=3)
    first = env.reset()["observation"]
    for _ in range(3):
        after = act(env, 1)
    assert after["observation"][0, 0] > first[0, 0] + 0.1  # the food has come nearer
    act(env, 2)
    turned = degrees(float(env.solver.body.heading[0]) - pi)
    assert turned == pytest.approx(15.0, abs=1e-9)


def test_bending_predator_observes_its_own_motion() -> None:
    margin = {"wall_margin_bl": 0.3, "control_interval_T": 0.25, "checks_per_action": 8}
    task = Predation(**TINY | margin, control=Bend(bend_bl=0.2))
    starts = task.sample_starts(1, torch.Generator().manual_seed(0)).expand(3)
    env = make_flows(task, 3, starts=starts)
    assert env.reset()["action_mask"].all()
    earned = [act(env, 0, 2, 2)["reward"] for _ in range(6)]
    body, now = env.solver.body, env.now
    assert body.torque_work.abs().max() < 1e-4 * body.positive_work.min()
    axis = body.heading + body.internal_angle
    right, left, same = (axis - pi).rad2deg().tolist()
    assert right < -5.0 and 5.0 < left == same
    wave, bend, frequency, yaw_rate, target = task.observe(now).split((2, 1, 1, 1, 4), -1)
    torch.testing.assert_close(wave.norm(dim=-1), torch.ones(3))
    torch.testing.assert_close(bend[:, 0], -body.bend.float())
    assert bend[0] < -0.15 and bend[1] > 0.15 and (frequency == 1.0).all()
    torch.testing.assert_close(yaw_rate[:, 0], (body.angular_velocity * task.scales.period).float())
    away = torch.atan2(target[:, 1], target[:, 0]).double()
    error = torch.remainder(away - axis + pi, 2.0 * pi) - pi
    torch.testing.assert_close(target[:, 3], error.float())
    rate = task.interval_T  # for approach, as for each beat
    assert torch.cat(earned).abs().flatten().tolist() == pytest.approx([rate] * 18, rel=1e-4)
