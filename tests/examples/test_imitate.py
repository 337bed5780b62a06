"""Imitation of a trained policy, on kinematic fish."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from examples.imitate import Budget, Lesson, main
from fishrl.envs import Flows, make_env
from fishrl.envs.senses import SenseName
from fishrl.training import load_plan
from fishrl.training.algorithms.dqn import DQN
from fishrl.training.checkpoint import save_checkpoint
from fishrl.training.policy_spec import PolicySpec

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


def test_teacher_of_another_task_or_algorithm_is_refused(tmp_path: Path) -> None:
    plan = replace(load_plan("zoo/gait_bend"), algorithm=DQN())
    spec, folder = PolicySpec.for_task(plan.task), tmp_path / "dqn"
    actor = {"actor": plan.algorithm.make_policy(spec)}
    save_checkpoint(folder, actor, spec=spec, frames=1, config=plan.to_config())
    for teacher in ("zoo/predation_sharp", str(folder)):
        with pytest.raises(ValueError, match=rf"teacher = {teacher}: .* as zoo/gait_bend"):
            Lesson(teacher, ("place",), Budget())


def test_folder_that_is_there_is_refused_before_the_lesson(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["imitate.py", "place", "--folder", str(tmp_path)])
    with pytest.raises(SystemExit):
        main()
    assert "is there already" in capsys.readouterr().err
