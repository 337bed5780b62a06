"""What the benchmark times around the flow: environment, training, live view, profile."""

import pytest

from experiments.benchmarks.environment import (
    NUM_ACTIONS,
    Stage,
    list_parts,
    list_training,
    list_views,
)
from fishrl.envs import Predation
from fishrl.envs.scene import Frame
from fishrl.training.settings import LearningSettings
from fishrl.viewer import Drawing
from tests.envs.conftest import SMALL, gliding  # noqa: F401 - a fixture
from tests.envs.test_real_flow import TINY

SHORT = TINY | {"control_interval_T": 0.1, "checks_per_action": 2}  # few steps per action


@pytest.fixture(scope="module")
def stage() -> Stage:
    """Return an environment of two tiny eager flows."""
    return Stage(Predation(**SHORT), 2, compile=False)


def test_solver_environment_and_policy_advance_the_same_steps(stage: Stage) -> None:
    for run in (stage.run_solver, stage.run_env, stage.run_policy):
        stage.state = stage.env.reset()
        extras = run(1)
        assert stage.base.solver.body.age.tolist() == [stage.task.n_substeps] * 2
        assert extras is None or 0.0 < extras["outside_flow"] < 1.0


def test_flows_begin_anew_before_an_episode_can_end(stage: Stage) -> None:
    stage._num_actions = NUM_ACTIONS
    stage.base.solver.advance_(2)
    stage.prepare()
    assert stage.base.solver.body.age.tolist() == [0.0, 0.0]


def test_a_training_loop_collects_and_learns() -> None:
    settings = LearningSettings(num_envs=2, batch_size=2, updates_per_frame=2.0)
    gradient, frame = list_training(settings, Predation(**SHORT), compile=False)
    assert gradient.advance(2) is None
    extras = frame.advance(1)
    assert extras is not None
    assert 0.0 < extras["learning"] < 1.0


def test_a_profile_has_the_parts_of_the_flow_and_of_the_environment() -> None:
    parts = list_parts(Predation(**SHORT), num_envs=1, num_actions=1, compile=False)
    places = {entry.name: entry.facts["place"] for entry in parts}
    assert places["collision"] == places["edges"] == "flow"
    assert places["sensors and measurement"] == "environment"
    assert places["policy"] == "TorchRL and policy"
    assert all(entry.facts["seconds"] >= 0.0 for entry in parts)
    assert sum(entry.facts["share"] for entry in parts) == pytest.approx(1.0)


@pytest.mark.usefixtures("gliding")
def test_only_decisions_with_a_live_view_are_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    times: list[float] = []
    draw = Drawing.draw

    def note(drawing: Drawing, flow: int, frame: Frame) -> None:
        times.append(frame.time)
        draw(drawing, flow, frame)

    monkeypatch.setattr(Drawing, "draw", note)
    without, live = list_views(Predation(**SMALL), num_envs=2, compile=False, port=29680)
    for _ in range(2):
        for entry in (without, live):
            extras = entry.advance(1)
            assert extras is not None
            assert extras["processor"] > 0.0
    assert {int(time - 1e-6) for time in times} == {1, 3}  # every other decision
