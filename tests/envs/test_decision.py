"""How much a decision does outside the flow, on a CPU; ``tests/gpu`` counts a GPU's launches."""

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

from fishrl.envs import AbstractTask, Flows, Predation, make_env
from fishrl.physics.fast.batch import FlowBatch
from fishrl.physics.fast.execution import Execution
from tests.envs.conftest import keep_straight
from tests.envs.test_real_flow import TINY
from tests.envs.test_real_wake import make_task


class Operators(TorchDispatchMode):
    """Count the operators of torch."""

    num = 0

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        self.num += 1
        return func(*args, **kwargs or {})


@pytest.mark.parametrize(
    ("make", "most"),
    [(lambda: Predation(**TINY), 1010), (make_task, 2910)],
    ids=["predation", "karman"],
)
def test_decision_takes_few_operators_outside_the_flow(
    make: Callable[[], AbstractTask], most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As measured, whatever the number of flows; 2 us each, where they are small."""
    env = make_env(task=make(), flows=Flows(num_envs=4, compile=False), seed=0)
    _, state = env.step_and_maybe_reset(keep_straight(env.reset()))
    # the flow itself: steps, and its check, are recorded calls where it is compiled
    monkeypatch.setattr(Execution, "advance_", lambda *_: None)
    monkeypatch.setattr(FlowBatch, "is_fine", lambda self: torch.ones(4, dtype=torch.bool))
    with Operators() as operators:
        env.step(keep_straight(state))
    assert operators.num <= most
