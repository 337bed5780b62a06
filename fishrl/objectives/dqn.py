"""Deep Q-learning among legal actions, with and without a memory."""

from __future__ import annotations

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictSequential
from torch import Tensor
from torchrl.modules import set_recurrent_mode
from torchrl.objectives import DQNLoss, distance_loss


class MaskedDQNLoss(DQNLoss):
    """TorchRL's ``DQNLoss`` for networks that read an action mask; see ``make_value_actor``.

    Mnih et al. 2015, "Human-level control through deep reinforcement learning", and with
    ``is_double`` van Hasselt et al. 2016, "Deep Reinforcement Learning with Double Q-learning". The
    greatest value of the next state is that of its legal actions. Actions are integers; truncated
    states are bootstrapped, terminated ones not.

    Args:
        value_network: writes ``action_value`` and the greedy legal ``action``.
        is_double: let the network that learns choose the next action, and the target value it.
        loss_function: distance of the values to their target: smooth_l1, l2 or l1.
        mask_key: key of the mask ``[..., num_actions]``, true where an action is legal.

    Raises:
        ValueError: if the network does not read the mask.
    """

    out_keys = ["loss_qvalue"]

    def __init__(
        self,
        value_network: TensorDictSequential,
        *,
        is_double: bool = False,
        loss_function: str = "smooth_l1",
        mask_key: str = "action_mask",
    ) -> None:
        if mask_key not in value_network.in_keys:
            raise ValueError(
                f"value_network reads {value_network.in_keys}: it must read {mask_key!r}, or "
                "targets would be values of illegal actions; make it with make_value_actor"
            )
        super().__init__(
            value_network,
            loss_function=loss_function,
            double_dqn=is_double,
            action_space="categorical",
        )
        self.mask_key = mask_key

    def forward(self, tensordict: TensorDictBase) -> TensorDict:
        """Compute ``loss_qvalue`` of a batch of transitions, and write ``td_error`` into it."""
        return TensorDict({"loss_qvalue": super().forward(tensordict)["loss"]})


class RecurrentDQNLoss(MaskedDQNLoss):
    """The same for a network with an LSTM, on stretches of episodes.

    Hausknecht & Stone 2015, "Deep Recurrent Q-Learning for Partially Observable MDPs"; a stretch
    begins with the memory it was collected with (Kapturowski et al. 2019, "Recurrent Experience
    Replay in Distributed Reinforcement Learning").

    What differs from the parent's way with recurrent networks, and why: the parent runs the network
    over the next states from the memory that it has just overwritten, which is zero but at the
    stretch's end. Here it runs once over the states of the stretch and the one behind it, both with
    the weights that learn and with those of the target.

    Args:
        value_network: see ``fishrl.modules.make_recurrent_value_actor``.
        sequence_length: L, the transitions of a stretch. In a batch ``[N * L]`` stretches lie one
            behind the other; those of a shorter episode are filled up, ``("collector", "mask")``
            ``[N * L]`` is true where a transition is real.
        is_double: see ``MaskedDQNLoss``.
        loss_function: see ``MaskedDQNLoss``.
        in_key: key of the observation.
        mask_key: see ``MaskedDQNLoss``.
    """

    _MEMORY = ("recurrent_state_h", "recurrent_state_c")

    def __init__(
        self,
        value_network: TensorDictSequential,
        *,
        sequence_length: int,
        is_double: bool = False,
        loss_function: str = "smooth_l1",
        in_key: str = "observation",
        mask_key: str = "action_mask",
    ) -> None:
        super().__init__(
            value_network, is_double=is_double, loss_function=loss_function, mask_key=mask_key
        )
        self.sequence_length, self.in_key = sequence_length, in_key

    def _set_in_keys(self) -> None:
        """List what a transition must have; of the next state's memory, nothing."""
        seen = (self.in_key, self.mask_key)
        flags = ("reward", "done", "terminated")
        self._in_keys = [
            "action",
            "is_init",
            *self._MEMORY,
            *seen,
            *(("next", key) for key in (*seen, *flags)),
        ]

    def forward(self, tensordict: TensorDictBase) -> TensorDict:
        """Compute ``loss_qvalue``, the mean over the real transitions of a batch ``[N * L]``."""
        batch = tensordict.reshape(-1, self.sequence_length)
        states = self._states(batch)
        with set_recurrent_mode(True):
            values = self._values(states, self.value_network_params)
            with torch.no_grad():
                target = self._values(states, self.target_value_network_params)[:, 1:]
        chosen = values[:, :-1].gather(-1, batch["action"].unsqueeze(-1)).squeeze(-1)
        judge = values.detach()[:, 1:] if self.double_dqn else target
        next_value = target.gather(-1, judge.argmax(-1, keepdim=True))
        wanted = self.value_estimator.value_estimate(batch, next_value=next_value).squeeze(-1)
        loss = distance_loss(chosen, wanted, self.loss_function)
        is_real = batch["collector", "mask"].reshape(loss.shape)
        return TensorDict({"loss_qvalue": (loss * is_real).sum() / is_real.sum()})

    def _states(self, batch: TensorDictBase) -> TensorDict:
        """Return the states of stretches ``[N, L]`` and the one behind each, ``[N, L + 1]``.

        Behind the first they are the next states of its transitions, which are right also where a
        filled-up stretch repeats its last transition.
        """
        begins = batch["is_init"][:, :1]
        states = {
            key: torch.cat((batch[key][:, :1], batch["next", key]), 1)
            for key in (self.in_key, self.mask_key)
        }
        for key in self._MEMORY:  # only the first state's is read
            first = batch[key][:, :1] * ~begins.unsqueeze(-1)
            states[key] = first.expand(-1, self.sequence_length + 1, *first.shape[2:])
        num = (batch.shape[0], self.sequence_length + 1)
        states["is_init"] = torch.zeros(*num, 1, dtype=torch.bool, device=begins.device)
        return TensorDict(states, num)

    def _values(self, states: TensorDict, weights: TensorDictBase) -> Tensor:
        """Return values ``[N, L + 1, num_actions]``, the least number there is if illegal."""
        with weights.to_module(self.value_network, preserve_module_state=False):
            return self.value_network(states.clone(False))["action_value"]
