"""Losses of DQN and recurrent DQN, compared with their definitions."""

from typing import TypeVar

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor
from torch.nn.functional import smooth_l1_loss
from torchrl.objectives import SoftUpdate

from fishrl.modules import make_recurrent_value_actor, make_value_actor
from fishrl.objectives import MaskedDQNLoss, RecurrentDQNLoss
from tests.objectives.transitions import NUM_ACTIONS, NUM_INPUTS, make_transitions

GAMMA, LENGTH, WIDTH = 0.9, 6, 7
SIZES = {"num_inputs": NUM_INPUTS, "num_actions": NUM_ACTIONS}
Loss = TypeVar("Loss", MaskedDQNLoss, RecurrentDQNLoss)
pytestmark = pytest.mark.filterwarnings("ignore:No target network updater")


def prepare(loss: Loss) -> Loss:
    """Perturb the target network."""
    loss.make_value_estimator(gamma=GAMMA)
    SoftUpdate(loss, tau=0.1)
    torch.manual_seed(1)
    for weight in loss.target_value_network_params.values(True, True):
        weight.data.add_(0.3 * torch.randn_like(weight))
    return loss


def make_loss(*, is_double: bool) -> MaskedDQNLoss:
    actor = make_value_actor(**SIZES, hidden=(16,), generator=torch.Generator().manual_seed(0))
    return prepare(MaskedDQNLoss(actor, is_double=is_double))


def values_of(loss: MaskedDQNLoss, states: Tensor, *, is_target: bool) -> Tensor:
    weights = loss.target_value_network_params if is_target else loss.value_network_params
    with weights.to_module(loss.value_network, preserve_module_state=False):
        return loss.value_network[0].module(states)


@pytest.mark.parametrize("is_double", [False, True])
def test_loss_equals_definition_over_legal_actions(is_double: bool) -> None:
    loss, batch = make_loss(is_double=is_double), make_transitions()
    after = batch["next"]
    with torch.no_grad():
        target = values_of(loss, after["observation_stack"], is_target=True)
        judge = values_of(loss, after["observation_stack"], is_target=not is_double)
        best = judge.masked_fill(~after["action_mask"], -torch.inf).argmax(-1, keepdim=True)
        wanted = after["reward"] + GAMMA * ~after["terminated"] * target.gather(-1, best)
        values = values_of(loss, batch["observation_stack"], is_target=False)
        chosen = values.gather(-1, batch["action"][:, None])
    torch.testing.assert_close(loss(batch)["loss_qvalue"], smooth_l1_loss(chosen, wanted))


def stretches(num: int = 5) -> TensorDict:
    """Return sequences of 6 transitions as the sampler does; the second has 3 real ones."""
    torch.manual_seed(3)
    batch = make_transitions(num * LENGTH, key="observation").reshape(num, LENGTH)
    for key in ("observation", "action_mask"):
        batch[key][:, 1:] = batch["next", key][:, :-1]
    legal = batch["action_mask"].flatten(0, 1).float()
    batch["action"] = torch.multinomial(legal, 1).reshape(num, LENGTH)
    batch["next", "terminated"][:, :-1] = False
    batch["is_init"] = torch.zeros(num, LENGTH, 1, dtype=torch.bool)
    batch["is_init"][0, 0] = True
    for key in ("recurrent_state_h", "recurrent_state_c"):
        batch[key] = torch.randn(num, LENGTH, 1, WIDTH)
    mask = torch.ones(num, LENGTH, dtype=torch.bool)
    mask[1, 3:] = False
    for step in range(3, LENGTH):
        batch[1, step] = batch[1, 2].clone()
    batch["collector"] = TensorDict({"mask": mask}, [num, LENGTH])
    return batch.reshape(-1)


def unroll(loss: RecurrentDQNLoss, row: TensorDict, num: int, *, is_target: bool) -> Tensor:
    """Return the values of a sequence and of the state after it, step by step."""
    weights = loss.target_value_network_params if is_target else loss.value_network_params
    values = []
    memory = row[0].select("recurrent_state_h", "recurrent_state_c")
    with weights.to_module(loss.value_network, preserve_module_state=False), torch.no_grad():
        for step in range(num + 1):
            place = row[step] if step < num else row[num - 1]["next"]
            state = place.select("observation", "action_mask").update(memory)
            state["is_init"] = row["is_init"][0] if step == 0 else torch.tensor([False])
            after = loss.value_network(state.unsqueeze(0))[0]
            memory = after["next"].select("recurrent_state_h", "recurrent_state_c")
            values.append(after["action_value"])
    return torch.stack(values)


@pytest.mark.parametrize("hidden", [(8, WIDTH), (WIDTH,)])
@pytest.mark.parametrize("is_double", [False, True])
def test_recurrent_loss_equals_its_definition(is_double: bool, hidden: tuple[int, ...]) -> None:
    draw, batch, errors = torch.Generator().manual_seed(0), stretches(), []
    network = make_recurrent_value_actor(**SIZES, hidden=hidden, generator=draw)
    loss = prepare(RecurrentDQNLoss(network, sequence_length=LENGTH, is_double=is_double))
    for row in batch.reshape(-1, LENGTH):
        num = int(row["collector", "mask"].sum())
        values, target = (unroll(loss, row, num, is_target=flag) for flag in (False, True))
        for step in range(num):
            judge = values if is_double else target
            best = target[step + 1, judge[step + 1].argmax()]
            after = row[step]["next"]
            wanted = after["reward"] + GAMMA * ~after["terminated"] * best
            errors.append(smooth_l1_loss(values[step, row["action"][step]], wanted.squeeze()))
    assert len(errors) == 4 * LENGTH + 3
    got = loss(batch)["loss_qvalue"]
    torch.testing.assert_close(got, torch.stack(errors).mean(), rtol=1e-5, atol=1e-6)
    got.backward()
    weights = list(loss.value_network_params.values(True, True))
    assert all(weight.grad is not None and weight.grad.isfinite().all() for weight in weights)
    targets = loss.target_value_network_params.values(True, True)
    assert all(weight.grad is None for weight in targets)
