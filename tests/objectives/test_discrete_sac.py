"""The mask-aware loss compared with TorchRL's and with its definition."""

import math
import runpy
from typing import Any

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.data import Categorical
from torchrl.modules import MaskedCategorical, ProbabilisticActor
from torchrl.objectives import DiscreteSACLoss

from fishrl.modules import make_mlp, make_twin_critics
from fishrl.objectives import MaskedDiscreteSACLoss, discrete_sac
from tests.objectives.transitions import NUM_ACTIONS, NUM_INPUTS, make_transitions

pytestmark = pytest.mark.filterwarnings("ignore:No target network updater")
LOSSES = ("loss_actor", "loss_qvalue", "loss_alpha", "entropy")


def actor_with(neg_inf: float) -> ProbabilisticActor:
    network = make_mlp([NUM_INPUTS, 32, NUM_ACTIONS], generator=torch.Generator().manual_seed(0))
    return ProbabilisticActor(
        TensorDictModule(network, in_keys=["observation_stack"], out_keys=["logits"]),
        in_keys={"logits": "logits", "mask": "action_mask"},
        out_keys=["action"],
        spec=Categorical(NUM_ACTIONS),
        distribution_class=MaskedCategorical,
        distribution_kwargs={"neg_inf": neg_inf},
    )


def critics() -> list[TensorDictModule]:
    draw = torch.Generator().manual_seed(1)
    return make_twin_critics(
        num_inputs=NUM_INPUTS, num_actions=NUM_ACTIONS, hidden=(32,), generator=draw
    )


def make_loss(*, neg_inf: float = -1e9, **kwargs: Any) -> MaskedDiscreteSACLoss:
    loss = MaskedDiscreteSACLoss(actor_with(neg_inf), critics(), num_actions=NUM_ACTIONS, **kwargs)
    loss.make_value_estimator(gamma=0.9)
    return loss


def make_parent(*, neg_inf: float = -1e9, **kwargs: Any) -> DiscreteSACLoss:
    """Without vmap, whose sums differ in the last bit."""
    loss = DiscreteSACLoss(
        actor_with(neg_inf), critics(), action_space="categorical", num_actions=NUM_ACTIONS,
        deactivate_vmap=True, **kwargs,
    )  # fmt: skip
    loss.make_value_estimator(gamma=0.9)
    return loss


def backward(loss: DiscreteSACLoss, data: TensorDict) -> tuple[TensorDict, dict[str, torch.Tensor]]:
    out = loss(data.clone())
    (out["loss_actor"] + out["loss_qvalue"] + out["loss_alpha"]).backward()
    gradients = {n: p.grad for n, p in loss.named_parameters() if p.grad is not None}
    return out, gradients


def is_finite(out: TensorDict, gradients: dict[str, torch.Tensor]) -> bool:
    values = (*(out[key] for key in LOSSES), *gradients.values())
    return all(bool(value.isfinite().all()) for value in values)


def test_equals_parent_bitwise_when_all_actions_are_legal() -> None:
    data = make_transitions(is_all_legal=True)
    ours, our_gradients = backward(make_loss(), data)
    theirs, their_gradients = backward(make_parent(), data)
    for key in (*LOSSES, "alpha"):
        assert torch.equal(ours[key], theirs[key]), key
    assert our_gradients.keys() == their_gradients.keys()
    for name, gradient in our_gradients.items():
        assert torch.equal(gradient, their_gradients[name]), name


@pytest.mark.parametrize("neg_inf", [-math.inf, -1e9])
def test_masked_gradients_are_finite_and_equal_parent(neg_inf: float) -> None:
    out, ours = backward(make_loss(neg_inf=neg_inf), make_transitions())
    assert is_finite(out, ours)
    _, theirs = backward(make_parent(), make_transitions())
    for name in ours:
        if "alpha" not in name:
            assert torch.allclose(ours[name], theirs[name], atol=1e-6), name


def reference_target(loss: DiscreteSACLoss, data: TensorDict) -> torch.Tensor:
    """Return r + gamma (1 - terminated) sum_a pi (min Q - alpha log pi) over legal actions."""
    following, targets = data["next"], []
    actor = loss.get_stateful_net("actor_network")
    for i in range(data.shape[0]):
        legal = following["action_mask"][i].nonzero().squeeze(-1)
        stack = following["observation_stack"][i]
        logits = actor[0].module(stack)[legal]
        log_prob = logits - logits.logsumexp(-1)
        # targets start as copies
        values = torch.stack([critic.module(stack)[legal] for critic in critics()])
        state_value = (log_prob.exp() * (values.min(0)[0] - loss._alpha * log_prob)).sum()
        bootstrap = 0.0 if following["terminated"][i] else 0.9
        targets.append(following["reward"][i, 0] + bootstrap * state_value)
    return torch.stack(targets)


def test_target_bootstraps_truncated_but_not_terminated_states() -> None:
    data, loss = make_transitions(), make_loss()
    with torch.no_grad():
        target = loss._compute_target(data)
        assert torch.allclose(target, reference_target(loss, data), atol=1e-5)
        is_truncated = (data["next", "done"] & ~data["next", "terminated"]).squeeze(-1)
        assert is_truncated.any()
        reward = data["next", "reward"].squeeze(-1)
        assert not torch.isclose(target, reward)[is_truncated].any()


def alpha_after(loss: DiscreteSACLoss, data: TensorDict, *, num_steps: int) -> tuple[float, float]:
    """Train actor and temperature, with fixed critics; return alpha and entropy."""
    optimiser = torch.optim.Adam([p for n, p in loss.named_parameters() if "qvalue" not in n], 0.02)
    for _ in range(num_steps):
        out = loss(data.clone())
        optimiser.zero_grad()
        (out["loss_actor"] + out["loss_alpha"]).backward()
        optimiser.step()
    return float(out["alpha"]), float(out["entropy"])


def test_temperature_reaches_attainable_entropy() -> None:
    data = make_transitions()
    num_legal = data["action_mask"].sum(-1)
    largest = num_legal.double().log()
    assert largest.mean() < 0.98 * math.log(NUM_ACTIONS)  # target of the parent
    alpha, entropy = alpha_after(make_loss(target_entropy_weight=0.7), data, num_steps=200)
    assert entropy == pytest.approx(0.7 * float(largest.mean()), abs=0.05)
    assert alpha < 1.0


def test_states_with_single_action_leave_temperature_unchanged() -> None:
    data = make_transitions()
    data["action_mask"] = nn.functional.one_hot(data["action"], NUM_ACTIONS).bool()
    loss = make_loss()
    out, gradients = backward(loss, data)
    assert out["loss_alpha"] == 0 and gradients["log_alpha"] == 0
    assert out["entropy_fraction"] == 0
    assert is_finite(out, gradients)


def test_row_without_legal_actions_has_no_policy_gradient() -> None:
    data = make_transitions()
    data["action_mask"][0] = False
    data["next", "action_mask"][0] = False
    loss = make_loss()
    out, gradients = backward(loss, data)
    assert is_finite(out, gradients)
    _, rest = backward(make_loss(), data[1:])
    for name in gradients:
        if "actor" in name:
            assert torch.allclose(gradients[name], rest[name] * 63 / 64, atol=1e-6), name


def test_initial_weights_of_critics_are_kept() -> None:
    loss = make_loss()
    given = [next(iter(critic.parameters())) for critic in critics()]
    kept = next(p for n, p in loss.named_parameters() if "qvalue" in n and "weight" in n)
    assert torch.equal(kept, torch.stack([weight.data for weight in given]))


def test_import_after_torchrl_loss_keeps_out_keys() -> None:
    """The first instance of TorchRL's loss turns ``out_keys`` of its class into a property."""
    before = make_parent().out_keys
    again = runpy.run_path(discrete_sac.__file__)["MaskedDiscreteSACLoss"]
    assert again.out_keys == [*before, "entropy_fraction"]
