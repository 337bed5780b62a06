"""What the benchmark times around the flow: environment, training, live view, profile."""

import pytest
import torch

from experiments.benchmarks.comparison import BenchmarkSettings
from experiments.benchmarks.environment import (
    NUM_ACTIONS,
    Stage,
    make_live,
    make_overhead,
    make_profile,
    make_training,
)
from fishrl.envs import Predation
from fishrl.envs.scene import Frame
from fishrl.training.settings import LearningSettings
from fishrl.viewer import Drawing
from tests.envs.conftest import SMALL, kinematic  # noqa: F401 - a fixture
from tests.envs.test_real_flow import TINY

SHORT = TINY | {"control_interval_T": 0.1, "checks_per_action": 2}  # few steps per action


SETTINGS = BenchmarkSettings()


def test_the_environment_takes_longer_than_its_flow() -> None:
    solver, env, policy = make_overhead(
        SETTINGS, task=Predation(**SHORT), num_envs=2, compile=False
    )
    assert solver.num_nodes == env.num_nodes == policy.num_nodes
    for case in (solver, env, policy):
        case.prepare()
        extras = case.advance(1)
        assert case is solver or 0.0 < extras["outside_flow"] < 1.0


def test_flows_begin_anew_before_an_episode_can_end() -> None:
    stage = Stage(Predation(**SHORT), 2, compile=False)
    ages, straight = [], torch.ones(2, dtype=torch.int64)
    for _ in range(NUM_ACTIONS):
        stage.base.step(stage.state.clone().set("action", straight))
        ages.append(stage.base.solver.body.age.tolist())
        stage.prepare()
    assert ages == [[stage.task.n_substeps * (i + 1.0)] * 2 for i in range(NUM_ACTIONS)]
    assert stage.base.solver.body.age.tolist() == [0.0, 0.0]


def test_a_training_loop_collects_and_learns() -> None:
    learning = LearningSettings(num_envs=2, batch_size=2, updates_per_frame=2.0)
    task = Predation(**SHORT)
    gradient, frame = make_training(SETTINGS, task=task, learning=learning, compile=False)
    assert gradient.advance(2) is None
    extras = frame.advance(1)
    assert extras is not None
    assert 0.0 < extras["learning"] < 1.0


def test_a_profile_has_the_parts_of_the_flow_and_of_the_environment() -> None:
    task = Predation(**SHORT | {"control_interval_T": 0.05})
    parts = make_profile(SETTINGS, task=task, num_actions=1, compile=False)
    places = {case.name: case.facts["place"] for case in parts}
    assert places["collision"] == places["edges"] == "flow"
    assert places["sensors and measurement"] == "environment"
    assert places["policy"] == "TorchRL and policy"
    assert all(case.facts["seconds"] >= 0.0 for case in parts)
    assert sum(case.facts["share"] for case in parts) == pytest.approx(1.0)


@pytest.mark.usefixtures("kinematic")
def test_only_decisions_with_a_live_view_are_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    times: list[float] = []
    draw = Drawing.draw

    def note(drawing: Drawing, flow: int, frame: Frame) -> None:
        times.append(frame.time)
        draw(drawing, flow, frame)

    monkeypatch.setattr(Drawing, "draw", note)
    without, live = make_live(SETTINGS, task=Predation(**SMALL), compile=False, port=29680)
    for _ in range(2):
        for case in (without, live):
            extras = case.advance(1)
            assert extras is not None
            assert extras["processor"] > 0.0
    assert {int(time - 1e-6) for time in times} == {1, 3}  # every other decision
