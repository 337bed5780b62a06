"""Learning from past transitions, whichever policy took them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data.replay_buffers.samplers import Sampler
from torchrl.envs import Transform
from torchrl.objectives import SoftUpdate

from fishrl.training.learner import Learner, Networks
from fishrl.training.settings import LearningSettings


class OffPolicyLearner(Learner):
    """Replay buffer and target networks; arguments as for ``Learner``."""

    def __init__(
        self,
        networks: Networks,
        settings: LearningSettings,
        *,
        keys: Sequence[Any] = (),
        sampler: Sampler | None = None,
        transforms: Sequence[Transform] = (),
        is_traced: bool = False,
    ) -> None:
        networks.loss.make_value_estimator(gamma=settings.gamma)
        self._targets = SoftUpdate(networks.loss, tau=settings.tau)
        super().__init__(
            networks,
            settings,
            keys=keys,
            sampler=sampler,
            transforms=transforms,
            is_traced=is_traced,
        )

    def _remember(self, transitions: TensorDictBase) -> None:
        self._extend(transitions)

    def _take_step(self, batch: TensorDictBase) -> list[Tensor]:
        losses = super()._take_step(batch)
        self._targets.step()
        return losses
