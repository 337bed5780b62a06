"""An environment writes what only critics read, stacked by itself, and without it nothing."""

from collections.abc import Mapping
from typing import Any, ClassVar

import pytest
import torch
from torchrl.envs.utils import check_env_specs

from fishrl.envs import Flows, KarmanGait, Predation, PredationPair, make_env
from fishrl.envs.sense import Sense
from tests.envs.conftest import SMALL

FLOWS = Flows(num_envs=3, compile=False)


@pytest.mark.usefixtures("kinematic")
def test_critic_stack_holds_the_named_senses_of_the_last_decisions() -> None:
    task = KarmanGait(
        observes=("own_motion",), critic_observes=("place", "heading"), critic_num_stacked=2
    )
    env = make_env(task=task, flows=FLOWS)
    check_env_specs(env)
    state, seen = env.reset(), []
    for _ in range(3):
        seen.append(torch.cat((state["place"], state["angle_of_attack"]), -1).float())
        step = env.step(env.rand_action(state))
        state = env.step_mdp(step)
    seen.append(torch.cat((state["place"], state["angle_of_attack"]), -1).float())
    torch.testing.assert_close(state["critic_stack"], torch.cat(seen[-2:], -1))
    assert state["observation_stack"].shape == (3, 5 * task.num_stacked)


@pytest.mark.usefixtures("kinematic")
def test_own_task_gives_its_critics_what_it_likes_by_one_property() -> None:
    class Pair(PredationPair):
        @property
        def critic_senses(self) -> tuple[Sense, ...]:
            return (Sense("sum", ("x + y [L]",), lambda now: now["target"][..., :2].sum(-1, True)),)

    env = make_env(task=Pair(**SMALL), flows=FLOWS)
    stack = env.reset()["agents", "critic_stack"]
    assert stack.shape == (3, 2, 4)
    own = env.base_env.now["target"][..., :2].sum(-1, keepdim=True).float()
    torch.testing.assert_close(stack, own.expand_as(stack))


@pytest.mark.usefixtures("kinematic")
def test_without_senses_of_critics_there_is_no_such_entry() -> None:
    state = make_env(task=Predation(**SMALL), flows=FLOWS).reset()
    assert not any("critic" in str(key) for key in state.keys(True))


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"critic_observes": ("flow_label",)}, "allowed are heading, .*, lateral_line$"),
        ({"critic_reads_stack": False}, "critics need critic_observes"),
    ],
)
def test_what_critics_cannot_read_is_refused(settings: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        KarmanGait(**settings)


def test_task_without_senses_must_give_those_of_critics() -> None:
    class Own(Predation):
        known_senses: ClassVar[Mapping[str, Sense]] = {}

    with pytest.raises(ValueError, match="lists no senses; define its critic_senses"):
        Own(critic_observes=("place",))
