"""A fish that bends in a stream, in a real flow."""

from math import exp

import pytest
import torch
from tensordict import TensorDict

from fishrl.envs import KarmanGait
from fishrl.envs.macro_actions import BendControl, ContinuousFrequency, MacroActions
from fishrl.envs.streams import Stream
from tests.envs.conftest import SMALL, make_flows

TINY = SMALL | {"wall_margin_bl": 0.4, "control_interval_T": 0.25, "checks_per_action": 10}
TINY |= {"stream": Stream(speeds_bl=(1.0,), has_disc=False, face_bl=1.0), "start_flows": (0,)}
TINY |= {"domain_bl": (5.0, 2.4)}


@pytest.mark.parametrize("is_continuous", [False, True])
def test_bending_fish_is_turned_by_the_water_alone_and_pays_for_pushing_work(
    is_continuous: bool,
) -> None:
    beat = ContinuousFrequency() if is_continuous else MacroActions(rows=((0.5, 1.0, 1.5),))
    task = KarmanGait(**TINY, control=BendControl(beat=beat, bend_bl=0.1, response_T=0.125))
    env = make_flows(task, 2)
    env.reset()
    assert env.task.fish.motion.free_axes == (0, 1, 2)
    left, right = ([[1.0, 0.0], [-1.0, 0.0]]) if is_continuous else (3, 5)
    step = env.step(TensorDict({"action": torch.tensor([left, right])}, [2]))["next"]
    # a command of two time constants; the tail is on the side of the turn
    goal = 0.1 * (1.0 - exp(-2.0))
    assert (-env.solver.body.bend).tolist() == pytest.approx([goal, -goal], rel=0.02)
    assert env.now["own_motion"][:, 2].tolist() == (-env.solver.body.bend).tolist()
    assert step["torque_work"].abs().max() < 1e-4 * step["positive_work"].min()
    before, after = env.now.clone(), env.now.clone()
    after["positive_work"] += 0.1
    after["work"] -= 5.0
    paid = env.task.reward(before, before) - env.task.reward(before, after)
    assert paid.tolist() == pytest.approx([0.1, 0.1])
