"""Half of the replayed transitions are reflected, whole and consistently."""

from typing import Any

import pytest
import torch
from tensordict import TensorDict

from fishrl.envs.mirror import Mirror
from fishrl.training import Algorithm
from fishrl.training.algorithms.drqn import DRQN
from fishrl.training.algorithms.ppo import PPO
from fishrl.training.reflection import Reflection
from tests.training.conftest import Toy

STACKS = {"observation_stack": (6, 2), "critic_stack": (1, 1)}
#: Of x, y and a flow label that a transform appends.
MIRROR = Mirror(observation=(1, -2), critic_observation=(-1,), action=(2, 1, 0))


def make_transitions(num: int) -> TensorDict:
    state: dict[str, Any] = {
        "observation_stack": torch.randn(num, 6),
        "critic_stack": torch.randn(num, 1),
        "action_mask": torch.rand(num, 3) < 0.5,
    }
    following = {name: value.flip(0) for name, value in state.items()}
    action = torch.randint(3, (num,))
    return TensorDict({**state, "action": action, "next": {**following, "reward": action}}, [num])


def test_mirror_image_has_the_signs_of_each_stacked_observation() -> None:
    transitions = make_transitions(40)
    image = Reflection(MIRROR, STACKS).reflect(transitions)
    sign = torch.tensor([1.0, -1.0, 1.0, 1.0, -1.0, 1.0])
    for before, after in ((transitions, image), (transitions["next"], image["next"])):
        assert torch.equal(after["observation_stack"], sign * before["observation_stack"])
        assert torch.equal(after["critic_stack"], -before["critic_stack"])
        assert torch.equal(after["action_mask"], before["action_mask"].flip(-1))
    assert torch.equal(image["action"], 2 - transitions["action"])
    assert torch.equal(image["next", "reward"], transitions["next", "reward"])


def test_continuous_action_changes_its_signs() -> None:
    reflection = Reflection(MIRROR._replace(action=(-1, 1)), STACKS)
    transitions = make_transitions(5).exclude("action_mask", ("next", "action_mask"))
    transitions["action"] = torch.randn(5, 2)
    image = reflection.reflect(transitions)["action"]
    assert torch.equal(image, transitions["action"] * torch.tensor([-1.0, 1.0]))


def test_half_of_the_transitions_is_reflected_whole() -> None:
    transitions, reflection = make_transitions(400), Reflection(MIRROR, STACKS)
    image, mixed = reflection.reflect(transitions), reflection(transitions)
    is_image = mixed["critic_stack"][:, 0] == image["critic_stack"][:, 0]
    assert 150 < int(is_image.sum()) < 250
    for row, from_image in enumerate(is_image):
        assert (mixed[row] == (image if from_image else transitions)[row]).all()


def test_mirror_that_is_no_reflection_is_refused() -> None:
    with pytest.raises(ValueError, match="whose own image must be the observation"):
        MIRROR._replace(observation=(2, -1)).check(num_obs=2, num_actions=3, is_discrete=True)


@pytest.mark.parametrize("algorithm", [PPO(rollout_length=8), DRQN()], ids=["ppo", "drqn"])
def test_rollouts_and_sequences_cannot_be_reflected(toy: Toy, algorithm: Algorithm) -> None:
    with pytest.raises(ValueError, match="reflect=false"):
        toy.begin(algorithm=algorithm, reflect=True)
