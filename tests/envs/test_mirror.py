"""A mirrored flow in which mirrored actions are taken gives the mirrored observations."""

from math import pi

import pytest
import torch
from torch import Tensor

from fishrl.envs import AbstractTask, Follower, KarmanGait, Predation, PredationPair
from fishrl.envs.control import Bend, ContinuousFrequency, DirectFrequencies, MacroActions, Turn
from fishrl.envs.flow_env import FlowEnv
from fishrl.envs.lateral_line import KNOWN, LateralLine
from fishrl.envs.mirror import Mirror
from fishrl.envs.steering import PIDSteering
from fishrl.envs.streams import Stream
from tests.envs.conftest import make_flows
from tests.envs.test_follower import TINY as FOLLOWER
from tests.envs.test_real_flow import TINY as TANK
from tests.envs.test_real_wake import TINY as STREAM

#: Directions north, north-east and north-west change places with south, south-east, south-west.
SWAPPED = {2: 4, 4: 2, 5: 8, 8: 5, 6: 7, 7: 6}
VECTORS = ("velocity", "load", "force", "hydro_force", "impulse")
ODD = ("heading", "internal_angle", "angular_velocity", "bend", "turn")
ODD += ("torque_impulse", "hydro_torque")

BEND = Bend(bend_bl=0.1, beat=DirectFrequencies(frequencies=(0.5, 1.0)))
MIRRORED = TANK | {"food_direction": "random", "control_interval_T": 0.25, "checks_per_action": 6}
SENSES = ("place", "drift", "heading", "own_motion", "tail_beat", "water_velocity", "lateral_line")
IN_STREAM = STREAM | {
    "stream": Stream(has_disc=False, face_bl=1.0, speeds_bl=(0.4,)),
    "start_flows": (0,),
    "observes": SENSES,
    "control": MacroActions(rows=((0.25, 0.5, 1.0),)),
    "lateral_line": LateralLine(features=tuple(n for n in KNOWN if n != "y"), num_samples=4),
}
TASKS: dict[str, AbstractTask] = {
    "fish that turns": Predation(**MIRRORED),
    "pair": PredationPair(
        **MIRRORED | {"domain_bl": (5.0, 4.0), "food_y_bl": 2.0, "food_limits_bl": (1.0, 3.0)}
    ),
    "fish in a stream": KarmanGait(**IN_STREAM | {"control": BEND}),
    "steered fish in a stream": KarmanGait(**IN_STREAM, steering=PIDSteering()),
    "follower": Follower(**FOLLOWER),
}


def reflect_vector(vector: Tensor) -> Tensor:
    return vector * vector.new_tensor((1.0, -1.0))


def mirror_second_flow(env: FlowEnv) -> None:
    """Make the second flow the mirror image of the first."""
    state = env.solver.state_dict()
    for name, value in state.items():
        field = name.rpartition(".")[2]
        first = value[0]
        if field[0] == "f" and field[1:].isdigit():
            number = int(field[1:])
            first = state[f"f{SWAPPED.get(number, number)}"][0].flip(0)
        elif field == "position":
            first = reflect_vector(first)
            first[1] += env.solver.config.height - 1.0
        elif field == "slip_impulse":
            first = first * first.new_tensor((1.0, -1.0, -1.0))
        elif field == "phase":
            first = first + pi
        elif field in VECTORS:
            first = reflect_vector(first)
        elif field in ODD:
            first = -first
        value[1] = first
    before = env.solver.state_dict()
    assert state.keys() == before.keys()
    env.solver.load_state_dict(state)
    env.start[1] = env.start[0]
    if "steering" in env.now:  # offsets and headings that the controller remembers
        env.now["steering"][1] = -env.now["steering"][0]
    if "food_direction" in env.start:
        env.start["food_direction"][1] *= -1.0


def reflect(numbers: Tensor, signed: tuple[int, ...]) -> Tensor:
    entries = torch.tensor(signed)
    return numbers[..., entries.abs() - 1] * entries.sign()


@pytest.mark.parametrize("name", TASKS)
def test_mirrored_actions_in_a_mirrored_flow_give_mirrored_observations(name: str) -> None:
    task = TASKS[name]
    env, mirror = make_flows(task, 2, seed=1), task.mirror
    generator = torch.Generator().manual_seed(0)
    step = env.reset()
    for decision in range(4):
        action = env.rand_action(step).select("action", ("agents", "action"), strict=False)
        key = "action" if task.num_fish == 1 else ("agents", "action")
        if task.action_bounds is None:
            chosen = torch.randint(task.num_actions, action[key][0].shape, generator=generator)
            pair = (chosen, torch.tensor(mirror.action)[chosen])
        else:
            chosen = 2.0 * torch.rand(task.num_actions, generator=generator) - 1.0
            pair = (chosen, chosen * torch.tensor(mirror.action))
        if decision == 2:
            mirror_second_flow(env)
        action[key] = torch.stack(pair)
        step = env.step_mdp(env.step(action))
    now = env.task.observe(env.now)
    assert not env.now["clearance"].isnan().any()
    # round-off was 7e-6; of the food the axis is half a node higher than that of the tank
    tolerance = 1.0 / task.body_length + 1e-3 if "food_direction" in env.start else 3e-5
    torch.testing.assert_close(
        now[1], reflect(now[0], mirror.observation), rtol=1e-3, atol=tolerance
    )
    assert (now[1] - now[0]).abs().max() > 5.0 * tolerance  # the flows are not symmetric


def test_mirror_of_an_own_control_may_be_that_of_its_base() -> None:
    class Steers(Turn):
        @property
        def mirrored_actions(self) -> tuple[int, ...]:
            return super(Turn, self).mirrored_actions

    assert Steers().mirrored_actions == (2, 1, 0)


@pytest.mark.parametrize(
    ("images", "is_discrete", "said"),
    [
        ((1, 2, 0), True, "mirrored_actions = .* each of 0 to 2"),
        ((0, 0, 0), True, "each of 0 to 2"),
        ((1, 0), True, "each of 0 to 2"),
        ((-1, 1), False, "3 signs"),
        ((2, 1, 1), False, "3 signs"),
    ],
)
def test_actions_without_a_mirror_image_are_refused(
    images: tuple[int, ...], is_discrete: bool, said: str
) -> None:
    with pytest.raises(ValueError, match=said):
        Mirror((1,), (), images).check(num_obs=1, num_actions=3, is_discrete=is_discrete)


def test_task_that_observes_without_senses_has_no_mirror_image() -> None:
    class Observing(Predation):
        n_obs = 2
        senses = ()

    with pytest.raises(ValueError, match="of 0 of 2 numbers is known"):
        _ = Observing(**MIRRORED).mirror


def test_follower_may_steer_without_a_mirror_image() -> None:
    class Steers(Bend):
        @property
        def mirrored_actions(self) -> tuple[int, ...]:
            raise ValueError("none")

    plain = Follower(**FOLLOWER)
    own = Follower(**FOLLOWER | {"control": Steers(bend_bl=0.1, beat=ContinuousFrequency())})
    assert own.n_obs == plain.n_obs
    with pytest.raises(ValueError, match="none"):
        _ = own.mirror
