"""Losses of DQN, double DQN and recurrent DQN with action masks."""

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictSequential
from torch import Tensor
from torchrl.modules import set_recurrent_mode
from torchrl.objectives import DQNLoss, distance_loss


class MaskedDQNLoss(DQNLoss):
    """TorchRL's ``DQNLoss`` for networks that read an action mask.

    Mnih et al. 2015, "Human-level control through deep reinforcement learning", and with
    ``is_double`` van Hasselt et al. 2016, "Deep Reinforcement Learning with Double Q-learning". The
    maximum over next actions includes legal actions only. Actions are integers; truncated states
    are bootstrapped, terminated ones are not.

    Args:
        value_network: see ``fishrl.modules.make_value_actor``.
        is_double: select the next action by the online network, evaluate it by the target network.
    """

    out_keys = ["loss_qvalue"]

    def __init__(self, value_network: TensorDictSequential, *, is_double: bool = False) -> None:
        if "action_mask" not in value_network.in_keys:
            raise ValueError(
                f"value_network reads {value_network.in_keys}, not 'action_mask', so that targets "
                "could be values of illegal actions: create it with make_value_actor"
            )
        super().__init__(
            value_network,
            loss_function="smooth_l1",
            double_dqn=is_double,
            action_space="categorical",
        )

    def forward(self, tensordict: TensorDictBase) -> TensorDict:
        """Compute ``loss_qvalue`` of a batch of transitions, and write ``td_error`` into it."""
        return TensorDict({"loss_qvalue": super().forward(tensordict)["loss"]})


class RecurrentDQNLoss(MaskedDQNLoss):
    """DQN loss for networks with an LSTM, on sequences of transitions.

    Hausknecht & Stone 2015, "Deep Recurrent Q-Learning for Partially Observable MDPs"; a sequence
    starts from its stored LSTM state (Kapturowski et al. 2019, "Recurrent Experience Replay in
    Distributed Reinforcement Learning"). All L + 1 states of a sequence are evaluated in one pass
    with the online and one with the target weights. TorchRL's ``DQNLoss`` instead evaluates the
    next states from an LSTM state that it has just overwritten, mostly with zeros.

    Args:
        value_network: see ``fishrl.modules.make_recurrent_value_actor``.
        sequence_length: transitions L of a sequence. A batch ``[N * L]`` holds N sequences, padded
            if shorter; ``("collector", "mask")`` ``[N * L]`` is true for real transitions.
        is_double: see ``MaskedDQNLoss``.
    """

    _MEMORY = ("recurrent_state_h", "recurrent_state_c")
    _OBSERVED = ("observation", "action_mask")

    def __init__(
        self, value_network: TensorDictSequential, *, sequence_length: int, is_double: bool = False
    ) -> None:
        super().__init__(value_network, is_double=is_double)
        self.sequence_length = sequence_length

    def _set_in_keys(self) -> None:
        """List the required entries of a transition, without the next LSTM state."""
        after = (*self._OBSERVED, "reward", "done", "terminated")
        following = (("next", key) for key in after)
        self._in_keys = ["action", "is_init", *self._MEMORY, *self._OBSERVED, *following]

    def forward(self, tensordict: TensorDictBase) -> TensorDict:
        """Compute ``loss_qvalue``, the mean over real transitions of a batch ``[N * L]``."""
        batch = tensordict.reshape(-1, self.sequence_length)
        states = self._states(batch)
        with set_recurrent_mode(True):
            values = self._values(states, self.value_network_params)
            with torch.no_grad():
                target = self._values(states, self.target_value_network_params)[:, 1:]
        chosen = values[:, :-1].gather(-1, batch["action"].unsqueeze(-1)).squeeze(-1)
        selecting = values.detach()[:, 1:] if self.double_dqn else target
        next_value = target.gather(-1, selecting.argmax(-1, keepdim=True))
        td_target = self.value_estimator.value_estimate(batch, next_value=next_value).squeeze(-1)
        is_real = batch["collector", "mask"].reshape(chosen.shape)
        # an illegal action in the padding would make the loss infinite
        loss = distance_loss(chosen.where(is_real, td_target), td_target, self.loss_function)
        return TensorDict({"loss_qvalue": loss.sum() / is_real.sum()})

    def _states(self, batch: TensorDictBase) -> TensorDict:
        """Return the states ``[N, L + 1]`` of sequences ``[N, L]``: the first and all next ones."""
        begins = batch["is_init"][:, :1]
        states = {
            key: torch.cat((batch[key][:, :1], batch["next", key]), 1) for key in self._OBSERVED
        }
        for key in self._MEMORY:  # the network reads the first only
            first = batch[key][:, :1] * ~begins.unsqueeze(-1)
            states[key] = first.expand(-1, self.sequence_length + 1, *first.shape[2:])
        num = (batch.shape[0], self.sequence_length + 1)
        states["is_init"] = torch.zeros(*num, 1, dtype=torch.bool, device=begins.device)
        return TensorDict(states, num)

    def _values(self, states: TensorDict, weights: TensorDictBase) -> Tensor:
        """Return action values ``[N, L + 1, num_actions]``, hugely negative if illegal."""
        with weights.to_module(self.value_network, preserve_module_state=False):
            values: Tensor = self.value_network(states.clone(False))["action_value"]
        return values
