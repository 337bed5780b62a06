"""Imitation of a trained policy, on kinematic fish."""

from dataclasses import replace

import pytest
import torch

from examples.imitate import Budget, Lesson
from fishrl.envs import Flows, make_env
from fishrl.envs.senses import SenseName

pytestmark = pytest.mark.usefixtures("kinematic")


def make_lesson(*more: SenseName, **changes: int) -> Lesson:
    budget, streams = Budget(**{"num_stacked": 2, **changes}), (0.4, 0.45, 0.5) if more else ()
    lesson = Lesson("zoo/gait_bend", ("place", "heading", *more), budget, streams)
    lesson.both = replace(lesson.both, time_limit=20)
    return lesson


@pytest.mark.parametrize("more", [(), ("flow_label",)])
def test_student_sees_what_its_own_task_shows(more: tuple[SenseName, ...]) -> None:
    lesson, seen = make_lesson(*more), []
    starts = lesson.task.sample_starts(2, torch.Generator().manual_seed(0))
    for task in (lesson.task, lesson.both):
        labels = lesson.recognition
        env = make_env(
            task=task, flows=Flows(num_envs=2, compile=False), starts=starts, recognition=labels
        )
        state, stacks = env.reset(), []
        for _ in range(4):
            state["action"] = torch.tensor([4, 5])
            stacks.append(state["observation_stack"])
            if task is lesson.both:
                stacks[-1] = lesson.act(state.clone(), 0.0)["inputs"]
            state = env.step_mdp(env.step(state))
        seen.append(torch.stack(stacks))
    assert torch.equal(*seen)


def test_imitation_reduces_loss_within_budget() -> None:
    lesson = make_lesson(decisions=100, episodes=2, epochs=20)
    spent, *_ = lesson.give(flows=Flows(num_envs=2, compile=False))[-1]
    assert 100 <= spent == sum(len(inputs) for inputs, *_ in lesson.seen) < 100 + 2 * 20
    inputs, wanted, mask = (torch.cat(part) for part in zip(*lesson.seen, strict=True))
    chance = wanted.masked_fill(~mask, -torch.inf).softmax(-1)
    untaught = make_lesson().policy.module[0].module
    before, after = (
        (net(inputs).masked_fill(~mask, -torch.inf).softmax(-1) - chance).abs().sum(-1).mean()
        for net in (untaught, lesson.policy.module[0].module)
    )
    assert after < 0.5 * before


def test_first_layer_takes_over_the_scaling() -> None:
    lesson = make_lesson()
    inputs = torch.randn(5, lesson.spec.num_inputs)
    lesson.student.mean, lesson.student.deviation = 3.0 * inputs[0], 2.0 + inputs[1].abs()
    before = lesson.student(inputs)
    lesson.student.fold()
    assert torch.allclose(lesson.policy.module[0].module(inputs), before, atol=1e-5)


def test_teacher_of_another_task_is_refused() -> None:
    with pytest.raises(ValueError, match=r"teacher = zoo/predation_sharp: .* as zoo/gait_bend"):
        Lesson("zoo/predation_sharp", ("place",), Budget())
