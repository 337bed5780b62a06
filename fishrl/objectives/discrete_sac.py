"""Discrete soft actor-critic with action masks.

Christodoulou 2019, "Soft Actor-Critic for Discrete Action Settings", eqs. 10-12. Differences from
TorchRL's ``DiscreteSACLoss``:

* The actor loss does not multiply a zero probability by the logit of an illegal action, whose
  default of minus infinity would make losses and gradients NaN.
* The target entropy of a state is a share of log(number of *legal* actions). A share of log(number
  of actions) may be unattainable, and the temperature would grow without bound.
* There is no ``skip_done_states``, which treats truncated states as terminal.
"""

import math

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import ProbabilisticTensorDictSequential, TensorDictModule, dispatch
from torch import Tensor
from torchrl.objectives import DiscreteSACLoss


class MaskedDiscreteSACLoss(DiscreteSACLoss):
    """Discrete SAC loss for actors with an action mask.

    If every action is legal, it equals TorchRL's ``DiscreteSACLoss`` with ``deactivate_vmap`` bit
    for bit. Actions are integers. The additional output ``entropy_fraction`` is the mean of entropy
    / log(number of legal actions) over states with a choice: 0 for a deterministic policy, 1 for a
    uniform one. Every state, including terminal ones, needs a legal action.

    Args:
        actor_network: policy with a mask, see ``fishrl.modules.make_actor``.
        qvalue_network: list of two or more critics, see ``fishrl.modules.make_twin_critics``.
        num_actions: number of actions, legal or not.
        alpha_init: initial temperature.
        target_entropy_weight: target entropy as a share of the maximum, log(num_legal).
    """

    out_keys = ["loss_actor", "loss_qvalue", "loss_alpha", "alpha", "entropy", "entropy_fraction"]
    target_entropy_by_count: Tensor

    def __init__(
        self,
        actor_network: ProbabilisticTensorDictSequential,
        qvalue_network: list[TensorDictModule],
        *,
        num_actions: int,
        alpha_init: float = 1.0,
        target_entropy_weight: float = 0.98,
    ) -> None:
        if not isinstance(qvalue_network, (list, tuple)) or len(qvalue_network) < 2:
            raise ValueError(
                "qvalue_network: must be a list of at least two critics, see make_twin_critics; "
                "TorchRL would resample the weights of a single one"
            )
        super().__init__(
            actor_network,
            list(qvalue_network),
            action_space="categorical",
            num_actions=num_actions,
            num_qvalue_nets=len(qvalue_network),
            alpha_init=alpha_init,
            target_entropy_weight=target_entropy_weight,
            deactivate_vmap=True,  # slower for two small critics
        )
        largest = [math.log(max(count, 1)) for count in range(num_actions + 1)]
        self.register_buffer("_largest_entropy", self.log_alpha.detach().new_tensor(largest))
        wanted = [target_entropy_weight * entropy for entropy in largest]
        self.register_buffer("target_entropy_by_count", self.log_alpha.detach().new_tensor(wanted))

    @dispatch  # type: ignore[untyped-decorator]
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Compute the losses of a batch of transitions, and write ``td_error`` into it."""
        loss_qvalue, value_metadata = self.qvalue_loss(tensordict)
        loss_actor, actor_metadata = self.actor_loss(tensordict)
        log_prob, num_legal = actor_metadata["log_prob"], actor_metadata["num_legal"]
        loss_alpha = self._reduce_loss(
            self._temperature_loss(log_prob, num_legal),
            tensordict=tensordict,
            weights=self._maybe_get_priority_weight(tensordict),
        )
        tensordict.set(self.tensor_keys.priority, value_metadata["td_error"])
        has_choice = num_legal > 1
        fraction = -log_prob / self._largest_entropy[num_legal].clamp_min(math.log(2.0))
        outputs = {
            "loss_actor": loss_actor,
            "loss_qvalue": loss_qvalue,
            "loss_alpha": loss_alpha,
            "alpha": self._alpha,
            "entropy": -log_prob.mean(),
            "entropy_fraction": (fraction * has_choice).sum() / has_choice.sum().clamp_min(1),
        }
        losses = TensorDict(outputs)
        self._clear_weakrefs(
            tensordict,
            losses,
            "actor_network_params",
            "qvalue_network_params",
            "target_actor_network_params",
            "target_qvalue_network_params",
        )
        return losses

    def actor_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Compute E_s[sum_a pi(a|s) (alpha log pi(a|s) - min_i Q_i(s, a))] over legal actions.

        Returns:
            The loss, and ``log_prob`` ``[B]`` (minus the entropy, detached) and ``num_legal``
            ``[B]``.
        """
        mask = tensordict["action_mask"]
        with self.actor_network_params.to_module(self.actor_network, preserve_module_state=False):
            policy = self.actor_network.get_dist(tensordict.clone(False))
        prob = policy.probs
        log_prob = torch.where(mask, policy.logits, torch.zeros_like(policy.logits))
        values = self._vmap_qnetworkN0(
            tensordict.select(*self.qvalue_network.in_keys, strict=False),
            self._cached_detached_qvalue_params,
        )
        value = values.get(self.tensor_keys.action_value).min(0)[0]
        loss = (prob * (self._alpha * log_prob - value)).sum(-1)  # Christodoulou 2019, eq. 12
        loss = self._reduce_loss(
            loss, tensordict=tensordict, weights=self._maybe_get_priority_weight(tensordict)
        )
        metadata = {"log_prob": (log_prob * prob).sum(-1).detach(), "num_legal": mask.sum(-1)}
        return loss, metadata

    def _temperature_loss(self, log_prob: Tensor, num_legal: Tensor) -> Tensor:
        """Compute -log(alpha) (E[log pi] + target) of states with a choice, ``[B]``.

        Christodoulou 2019, eq. 11, with log(alpha) in place of alpha.
        """
        gap = log_prob + self.target_entropy_by_count[num_legal]
        loss: Tensor = -self.log_alpha * torch.where(num_legal > 1, gap, torch.zeros_like(gap))
        return loss
