"""Arguments that a solver refuses."""

import copy
import logging
import math
from collections.abc import Callable

import pytest
import torch

from fishrl.envs import Flows, Predation, make_env
from fishrl.physics import InPlaceSolver
from fishrl.physics.fast.batch import FlowBatch
from fishrl.physics.fast.execution import Execution
from fishrl.physics.flow import make_params
from tests.envs.test_real_flow import TINY
from tests.physics.fast.test_solver import HEADINGS, STARTS, TANK, TURN, make_solver

EVERY = torch.tensor([True, True, True])


def reset_in_stream(solver: InPlaceSolver, speed: float) -> None:
    solver.set_stream_speed_(torch.full((3,), 0.1))
    solver.reset_(EVERY, STARTS, HEADINGS, velocity=(speed, 0.0))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda s: s.advance_(2, rows=[True]), r"rows = \(True,\): must be an instance of Tensor"),
        (lambda s: s.advance_(2, rows=torch.ones(3)), "type torch.float32: give .* torch.bool"),
        (lambda s: s.command_(torch.zeros(3, 2), 2), "there is no body 1: the flow has 1"),
        (lambda s: s.command_(TURN, 2, torch.zeros(3, 1)), r"frequency has shape \(3, 1\)"),
        (lambda s: s.sample(torch.zeros(1, 5, 2)), r"points has shape \(1, 5, 2\)"),
        (lambda s: s.set_body_(0, make_params([TANK]).bodies[0]), r"params has shape \(1, .*\(3"),
        (lambda s: s.set_populations_(torch.zeros(3, 9, 2, 2)), "f has shape"),
        (lambda s: s.reset_(torch.ones(2), STARTS, HEADINGS), "rows has shape"),
        (lambda s: reset_in_stream(s, 4.0), r"times stream_speed = .*: allowed is at most 0\.3"),
        (lambda s: s.reset_(EVERY, STARTS * torch.inf, HEADINGS), "position = .*must be finite"),
        (lambda s: s.reset_(EVERY, STARTS, 0.35), "heading = 0.35: must be an instance of Tensor"),
        (lambda s: s.load_state_dict({}), "state 'f0' is nothing, expected torch.float32"),
    ],
)
def test_wrong_calls_are_refused(call: Callable[[InPlaceSolver], None], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call(make_solver())


@pytest.mark.parametrize("frequency", [math.nan, torch.zeros(3)])
def test_a_frequency_is_a_finite_number_or_one_for_each_flow(frequency: object) -> None:
    """Its bound is tested with those of commands."""
    with pytest.raises(ValueError, match=r"frequency = nan|frequency has shape \(3,\)"):
        InPlaceSolver(config=TANK, num_envs=2, frequency=frequency, compile=False)


def test_environment_with_workers_says_how_it_is_copied() -> None:
    env = make_env(task=Predation(**TINY), flows=Flows(num_envs=2, compile=False, num_workers=1))
    with pytest.raises(TypeError, match=r"make another one, and load_state_dict\(state_dict\(\)\)"):
        copy.deepcopy(env)
    env.close()


def test_compilation_and_idle_fish_are_logged_once(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    solver = InPlaceSolver(config=TANK, num_envs=1, num_workers=0)
    monkeypatch.setattr(Execution, "_compile_here", lambda *_: None)
    monkeypatch.setattr(FlowBatch, "is_new", lambda _: True)
    monkeypatch.setattr(FlowBatch, "advance_", lambda *_: None)
    with caplog.at_level(logging.WARNING):
        for _ in range(2):
            solver.advance_(2)
    said = sorted(record.getMessage().partition(":")[0] for record in caplog.records)
    assert said == ["compiling the flow step", "the fish does not beat"]
