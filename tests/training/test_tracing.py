"""A traced gradient step is the gradient step."""

import copy
from collections.abc import Callable

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from fishrl.training import DiscreteSAC
from fishrl.training.algorithms.dqn import DQN
from fishrl.training.algorithms.sac import SAC
from fishrl.training.learner import Learner
from fishrl.training.tracing import Traced
from tests.training.conftest import Toy

pytestmark = pytest.mark.usefixtures("traced_at_once")
ALGORITHMS = [DiscreteSAC(norms_critics=True), DQN(is_double=True), SAC()]


@pytest.fixture(params=ALGORITHMS, ids=lambda algorithm: type(algorithm).__name__)
def learner(request: pytest.FixtureRequest, toy: Toy) -> Learner:
    """Return a learner with transitions, and a few steps taken."""
    learner = toy.collect(request.param, 20, warmup_frames=10_000)
    for _ in range(4):
        learner.update()
    return learner


def step(learner: Learner, seed: int) -> dict[str, Tensor]:
    torch.manual_seed(seed)  # of the batch
    return learner.update()


def test_traced_step_equals_plain_step(learner: Learner, monkeypatch: pytest.MonkeyPatch) -> None:
    plain = copy.deepcopy(learner.loss.state_dict())
    optimiser = copy.deepcopy(learner.optimiser.state_dict())
    with monkeypatch.context() as patch:
        patch.setattr(learner.loss, "forward", lambda *_: pytest.fail("the loss was called"))
        traced = [step(learner, seed) for seed in range(3)]
    end = copy.deepcopy(learner.loss.state_dict())
    # a checkpoint replaces the tensors of the optimiser
    learner.loss.load_state_dict(plain)
    learner.optimiser.load_state_dict(copy.deepcopy(optimiser))
    again = [step(learner, seed) for seed in range(3)]
    learner.loss.load_state_dict(plain)
    learner.optimiser.load_state_dict(optimiser)
    learner._step = learner._take_step
    expected = [step(learner, seed) for seed in range(3)]
    for runs in zip(traced, again, expected, strict=True):
        for name in learner.reports:
            assert torch.equal(runs[0][name], runs[2][name]), name
            assert torch.equal(runs[1][name], runs[2][name]), name
    for name, value in learner.loss.state_dict().items():
        assert torch.equal(value, end[name]), name
    assert len({float(run["loss_qvalue"]) for run in expected}) == 3


def make_batch(size: int) -> TensorDict:
    return TensorDict({"x": torch.ones(size)}, [size])


def test_batch_of_another_shape_goes_to_the_function() -> None:
    calls: list[int] = []

    def double(batch: TensorDictBase) -> list[Tensor]:
        calls.append(len(batch))
        return [2.0 * batch["x"]]

    traced = Traced(double)
    for size in (2, 3, 3, 3, 2, 3):
        (result,) = traced(make_batch(size))
        assert torch.equal(result, torch.full((size,), 2.0))
    assert calls == [2, 3, 3, 2]


def differ_by_one(x: Tensor) -> Tensor:
    one, other = torch.zeros_like(x), torch.zeros_like(x)
    one += x
    return one - other


@pytest.mark.parametrize(
    "function", [lambda x: torch.randn_like(x) - torch.randn_like(x), differ_by_one]
)
def test_equal_operations_that_must_stay_apart_do(function: Callable[[Tensor], Tensor]) -> None:
    traced = Traced(lambda batch: [function(batch["x"])])
    for _ in range(4):
        assert traced(make_batch(2))[0].all()


def test_function_that_branches_on_values_is_refused() -> None:
    def branch(batch: TensorDictBase) -> list[Tensor]:
        return [batch["x"] if batch["x"].sum() > 0.0 else -batch["x"]]

    traced = Traced(branch)
    traced(make_batch(2))
    with pytest.raises(RuntimeError, match="tracing tensor"):
        traced(make_batch(2))
