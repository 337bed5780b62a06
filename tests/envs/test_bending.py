"""A fish that bends in a stream, in a real flow."""

from math import exp, pi

import pytest
import torch
from tensordict import TensorDict

from fishrl.envs import KarmanGait, Predation
from fishrl.envs.control import Bend, ContinuousFrequency, MacroActions
from fishrl.envs.streams import Stream
from tests.envs.conftest import SMALL, act, make_flows
from tests.envs.test_real_flow import TINY as TANK

TINY = SMALL | {"wall_margin_bl": 0.4, "control_interval_T": 0.25, "checks_per_action": 10}
TINY |= {"stream": Stream(speeds_bl=(1.0,), has_disc=False, face_bl=1.0), "start_flows": (0,)}
TINY |= {"domain_bl": (5.0, 2.4)}


@pytest.mark.parametrize("is_continuous", [False, True])
def test_bending_fish_is_turned_by_water_alone(is_continuous: bool) -> None:
    beat = ContinuousFrequency() if is_continuous else MacroActions(rows=((0.5, 1.0, 1.5),))
    task = KarmanGait(**TINY, control=Bend(beat=beat, bend_bl=0.1, response_T=0.125))
    env = make_flows(task, 2)
    env.reset()
    assert env.task.fish.motion.free_axes == (0, 1, 2)
    left, right = ([[1.0, 0.0], [-1.0, 0.0]]) if is_continuous else (5, 3)
    step = env.step(TensorDict({"action": torch.tensor([left, right])}, [2]))["next"]
    # a command of two time constants; the tail is on the side of the turn
    goal = 0.1 * (1.0 - exp(-2.0))
    assert (-env.solver.body.bend).tolist() == pytest.approx([goal, -goal], rel=0.02)
    assert env.now["own_motion"][:, 2].tolist() == (-env.solver.body.bend).tolist()
    assert step["torque_work"].abs().max() < 1e-4 * step["positive_work"].min()
    before, after = env.now.clone(), env.now.clone()
    after["positive_work"] += 0.1
    after["work"] -= 5.0
    saved = [env.task.reward(before, now)["work"] for now in (before, after)]
    paid = saved[0] - saved[1]
    assert paid.tolist() == pytest.approx([0.1, 0.1])


def test_bending_predator_observes_its_own_motion() -> None:
    margin = {"wall_margin_bl": 0.3, "control_interval_T": 0.25, "checks_per_action": 8}
    task = Predation(**TANK | margin, control=Bend(bend_bl=0.2))
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
