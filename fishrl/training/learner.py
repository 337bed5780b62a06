"""Learners: policy, buffer and gradient step, for on-policy and off-policy algorithms."""

import logging
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.data import LazyTensorStorage, SamplerWithoutReplacement, TensorDictReplayBuffer
from torchrl.data.replay_buffers.samplers import Sampler
from torchrl.envs import Transform
from torchrl.objectives import LossModule, SoftUpdate

from fishrl.envs.agents import EachFish
from fishrl.training.averaging import WeightAverage
from fishrl.training.policy_spec import PolicySpec
from fishrl.training.reflection import Reflection
from fishrl.training.scaling import Folding, InputScale, ScaledPolicy
from fishrl.training.settings import LearningSettings
from fishrl.training.tracing import Traced

#: Losses of critics; those of policy and temperature rest during ``critic_frames``.
CRITIC_LOSSES = frozenset(("loss_critic", "loss_qvalue"))


class Networks(NamedTuple):
    """The networks of an algorithm, on the device where they learn."""

    #: policy that is evaluated and saved, or the average of whose weights is; greedy under
    #: ``ExplorationType.DETERMINISTIC``
    actor: TensorDictModuleBase
    #: policy that collects, for one fish, with the same weights
    explorer: TensorDictModuleBase
    #: the sum of its outputs ``loss_...`` is minimised; all are logged as ``train/<name>``
    loss: LossModule
    spec: PolicySpec  #: sizes, entries and mirror image of the task
    transforms: Sequence[Transform] = ()  #: that the explorer needs in its environment
    sampler: Sampler | None = None  #: draws batches from the buffer; by default uniformly
    #: entries of a transition to store in addition to those that the loss reads
    keys: Sequence[Any] = ()
    is_traced: bool = False  #: see ``Algorithm``


class Learner(ABC):
    """Store transitions and take gradient steps on batches of them.

    Args:
        networks: networks and loss of the algorithm.
        settings: learning rate, batch size, buffer size, average of the policy, and how long it
            rests.

    Attributes:
        actor: policy that is evaluated and saved.
        explorer: policy that collects, for all fish; the collector saves its state.
        first_frames: env frames before the first gradient step.
    """

    def __init__(self, networks: Networks, settings: LearningSettings) -> None:
        self.actor, self.explorer, self.loss = networks.actor, networks.explorer, networks.loss
        self.first_frames = settings.warmup_frames + 1
        self.transforms, self._is_traced = networks.transforms, networks.is_traced
        self.reports = tuple(self.loss.out_keys)
        spec, keys = networks.spec, [*self.loss.in_keys, *networks.keys]
        if spec.num_critic_inputs:  # TorchRL's losses do not list it
            keys.append(("next", "critic_stack"))
        self._keys = list(dict.fromkeys(keys))
        if not any(name.startswith("loss_") for name in self.reports):
            raise ValueError(
                f"{type(self.loss).__name__} has the outputs {list(self.reports)}: the sum of "
                "those named loss_... is minimised; rename one in a subclass, as MaskedDQNLoss does"
            )
        if "action" not in self.explorer.out_keys:
            raise ValueError(
                f"{type(self.explorer).__name__} has the outputs {list(self.explorer.out_keys)}: "
                "an explorer must write an 'action'"
            )
        device = next(self.actor.parameters()).device
        used = {key: spec.stacks[key] for key in self._keys if key in spec.stacks}
        self._scale: InputScale | None = None
        if settings.scale_inputs:
            self._scale = InputScale(used).to(device)
            self.explorer = ScaledPolicy(self.explorer, self._scale)
        self._unmeasured = self._scale
        self._initial: Folding | None = None
        if settings.initial_policy is not None and self._scale is not None:
            self._initial = Folding(self.actor, self._scale)
        if spec.num_fish > 1:
            self.explorer = EachFish(self.explorer, self.explorer.out_keys)
        self._reflection: Reflection | None = None
        if spec.mirror is not None:
            self._reflection = Reflection(spec.mirror, used).to(device)
        self._average: WeightAverage | None = None
        if settings.actor_average or self._scale is not None:
            horizon = settings.actor_average * settings.updates_per_frame * spec.num_fish
            self._average = WeightAverage(self.actor, horizon=horizon, scale=self._scale)
            self.actor = self._average.policy
        self._rests = False
        if settings.critic_frames and not CRITIC_LOSSES & {*self.reports}:
            raise ValueError(
                f"critic_frames = {settings.critic_frames}: none of the outputs "
                f"{list(self.reports)} of {type(self.loss).__name__} is "
                f"{' or '.join(sorted(CRITIC_LOSSES))}; name that of its critics so in a subclass, "
                "or critic_frames=0"
            )
        weights = list(self.loss.parameters())
        self.optimiser = torch.optim.Adam(weights, lr=settings.learning_rate, fused=True)
        self._renew_step()
        # A checkpoint replaces the tensors of the optimiser, which a traced step has kept.
        self.optimiser.register_load_state_dict_post_hook(self._renew_step)
        self.buffer = TensorDictReplayBuffer(
            storage=_ZeroedStorage(settings.buffer_size * spec.num_fish, device=device),
            sampler=networks.sampler,
            batch_size=settings.batch_size,
            prefetch=0,  # threads would draw batches in an order that no seed fixes
        )

    def store(self, transitions: TensorDictBase) -> int:
        """Store transitions ``[N]`` except diverged ones, and return how many diverged.

        Raises:
            ValueError: if a state has no legal action, or an entry is not finite.
        """
        lost = transitions["next", "diverged"].reshape(-1)
        for key in self._keys:
            values = transitions.get(key, None)
            if values is not None and not values[~lost].isfinite().all():
                raise ValueError(
                    f"{key}: is not finite in a flow that has not diverged; mend terms of the "
                    "reward, or the observation"
                )
        mask = transitions.get(("next", "action_mask"))
        if mask is not None and not mask.any(-1).all():
            raise ValueError(
                "action_mask: a state has no legal action; every state needs one, final ones too"
            )
        self._remember(transitions)
        return int(lost.sum())

    @abstractmethod
    def _remember(self, transitions: TensorDictBase) -> None:
        """Add transitions ``[N]`` to the buffer, now or once enough of them are complete."""

    def _extend(self, transitions: TensorDictBase) -> None:
        valid = transitions.select(*self._keys)[~transitions["next", "diverged"].reshape(-1)]
        if valid.shape[0] > 0:
            self.buffer.extend(valid)

    @property
    def is_ready(self) -> bool:
        """Whether there are transitions to learn from."""
        return len(self.buffer) > 0

    def update(self) -> dict[str, Tensor]:
        """Take one gradient step and return all outputs of the loss by name."""
        if self._unmeasured is not None:
            self._measure(self.buffer[:])
        batch = self.buffer.sample()
        if self._reflection is not None:
            batch = self._reflection(batch)
        return dict(zip(self.reports, self._step(batch), strict=True))

    def rest_actor(self, is_resting: bool) -> None:
        """Let the critics alone learn in the next gradient steps, or all networks again."""
        if self._rests != is_resting:
            self._rests = is_resting
            self._renew_step()

    def _take_step(self, batch: TensorDictBase) -> list[Tensor]:
        losses = self.loss(self._read(batch))
        self.optimiser.zero_grad()
        sum(loss for name, loss in losses.items() if self._minimises(name)).backward()
        self.optimiser.step()
        if self._average is not None and not self._rests:
            self._average.step()
        return [losses[name].detach() for name in self.reports]

    def _minimises(self, name: str) -> bool:
        return name in CRITIC_LOSSES if self._rests else name.startswith("loss_")

    def _read(self, transitions: TensorDictBase) -> TensorDictBase:
        """Return transitions as networks read them."""
        return transitions if self._scale is None else self._scale(transitions)

    def _measure(self, data: TensorDictBase) -> None:
        """Measure the scale of inputs, unless a checkpoint has brought it."""
        if self._unmeasured is not None and not self._unmeasured.is_measured:
            self._unmeasured.measure_(data)
            if self._initial is not None:
                self._initial.undo_()
        self._unmeasured = None  # a GPU is not asked again

    def _renew_step(self, *_: Any) -> None:
        self._step = Traced(self._take_step) if self._is_traced else self._take_step

    def components(self) -> dict[str, Any]:
        """Return the components of a checkpoint by name."""
        names = ("actor", "loss", "optimiser", "buffer")
        optional = {"average": self._average, "scale": self._scale}
        used = {name: part for name, part in optional.items() if part is not None}
        return {name: getattr(self, name) for name in names} | used


class OffPolicyLearner(Learner):
    """Replay past transitions, with target networks; arguments as for ``Learner``."""

    def __init__(self, networks: Networks, settings: LearningSettings) -> None:
        networks.loss.make_value_estimator(gamma=settings.gamma)
        self._targets = SoftUpdate(networks.loss, tau=settings.tau)
        super().__init__(networks, settings)

    def _remember(self, transitions: TensorDictBase) -> None:
        self._extend(transitions)

    def _take_step(self, batch: TensorDictBase) -> list[Tensor]:
        losses = super()._take_step(batch)
        self._targets.step()
        return losses


class OnPolicyLearner(Learner):
    """Learn from each rollout of the current policy, every transition once per epoch.

    Args:
        networks: the loss has a critic and a value estimator with ``lmbda``, as TorchRL's PPO.
        settings: see ``Learner``; the buffer holds one rollout.
        rollout_length: decisions of each flow in a rollout.
        gae_lambda: lambda of generalised advantage estimation.
    """

    def __init__(
        self,
        networks: Networks,
        settings: LearningSettings,
        *,
        rollout_length: int,
        gae_lambda: float,
    ) -> None:
        networks.loss.make_value_estimator(gamma=settings.gamma, lmbda=gae_lambda)
        super().__init__(networks._replace(sampler=SamplerWithoutReplacement()), settings)
        if self._scale is not None:  # the policy must stay the one that took the first rollout
            self._initial = Folding(networks.actor, self._scale)
        self._collected = [*self._keys, ("next", "diverged")]
        self._keys += ["advantage", "value_target"]
        self._length, self._decisions = rollout_length, list[TensorDictBase]()
        self.first_frames = rollout_length * settings.flows.num_envs

    def _remember(self, transitions: TensorDictBase) -> None:
        """Take one decision of each flow, always in the same order."""
        decision = transitions.select(*self._collected)
        self._decisions.append(decision.clone())  # a collector reuses its memory
        if len(self._decisions) < self._length:
            return
        rollout: Any = torch.stack(self._decisions, 1).contiguous()
        self._decisions = []
        loss: Any = self.loss
        weights, targets = loss.critic_network_params, loss.target_critic_network_params
        self._measure(rollout)
        valued = self._read(rollout)
        with torch.no_grad():  # a diverged row bootstraps from its last state, as if truncated
            loss.value_estimator(valued, params=weights, target_params=targets)
        rollout.update(valued.select("advantage", "value_target"))
        self.buffer.empty()
        self._extend(rollout.reshape(-1))

    @property
    def is_ready(self) -> bool:
        """Whether the last ``store`` completed a rollout."""
        return not self._decisions and super().is_ready

    def state_dict(self) -> dict[str, Any]:
        """Return the decisions of an incomplete rollout."""
        return {"decisions": [decision.clone().to_dict() for decision in self._decisions]}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore a state of ``state_dict``."""
        self._decisions = [TensorDict.from_dict(d, batch_dims=1) for d in state["decisions"]]

    def components(self) -> dict[str, Any]:
        """Add the incomplete rollout."""
        return {"rollout": self, **super().components()}


class _ZeroedStorage(LazyTensorStorage):
    """Storage whose unwritten rows are zero, so that checkpoints hold no uninitialised memory."""

    def _init(self, *args: Any, **kwargs: Any) -> None:
        logger = logging.getLogger("torchrl")
        level = logger.level
        logger.setLevel(logging.WARNING)  # not the storage's shape
        super()._init(*args, **kwargs)
        logger.setLevel(level)
        self._storage.zero_()
