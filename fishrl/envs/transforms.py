"""Transforms that write flow labels: the true ones or those predicted by a classifier."""

from abc import abstractmethod
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torch.nn.functional import one_hot
from torchrl.data import Bounded, Categorical, Composite, TensorSpec, Unbounded
from torchrl.envs import EnvBase, Transform


class FlowLabelTransform(Transform):
    """Write the label of each row's flow; base of the two sources of labels below.

    Writes ``flow_probabilities`` ``[B, n]`` and ``flow_class`` ``[B]`` (int64, the most probable),
    which selects the row of frequencies at the next step, and appends the probabilities to
    ``observation``. Append it before the frame stack.

    A policy trained in a single flow should not observe the probabilities: inputs that are constant
    during training leave their weights untrained, and another flow would activate them.

    Args:
        num_flows: number of flows n.
        in_key: entry that the probabilities are computed from.
        is_observed: append the probabilities to the observation.
    """

    def __init__(self, *, num_flows: int, in_key: str, is_observed: bool = True) -> None:
        observed = ["observation"] if is_observed else []
        super().__init__(
            in_keys=[in_key, *observed], out_keys=["flow_probabilities", "flow_class", *observed]
        )
        self.num_flows, self.is_observed = num_flows, is_observed

    @abstractmethod
    def compute_probabilities(self, now: TensorDictBase, *, begins: Tensor | None) -> Tensor:
        """Return the probability of each flow ``[B, n]``, float32, from the env's output ``now``.

        ``begins`` ``[B]`` bool are the rows that a reset affects; None after a step of all rows.
        """

    def choose_label(self, probabilities: Tensor) -> Tensor:
        """Return the label ``[B]`` that selects the row of frequencies: the most probable one."""
        return probabilities.argmax(-1)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        return self._write(next_tensordict, begins=None)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        batch = tensordict_reset.batch_size
        begins = tensordict.get("_reset", default=None)
        if begins is None:
            begins = torch.ones(batch, dtype=torch.bool, device=tensordict_reset.device)
        return self._write(tensordict_reset, begins=begins.reshape(batch))

    @torch.no_grad()
    def _write(self, now: TensorDictBase, *, begins: Tensor | None) -> TensorDictBase:
        probabilities = self.compute_probabilities(now, begins=begins)
        now.set("flow_probabilities", probabilities)
        now.set("flow_class", self.choose_label(probabilities))
        if self.is_observed:
            old = now["observation"]
            now.set("observation", torch.cat((old, probabilities.to(old.dtype)), -1))
        return now

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Add the new entries and lengthen the observation if it includes the probabilities."""
        assert isinstance(observation_spec, Composite)  # of every environment
        spec = observation_spec.clone()
        old, batch = spec["observation"], spec.shape
        if self.is_observed:
            longer = (*old.shape[:-1], old.shape[-1] + self.num_flows)
            spec["observation"] = Unbounded(longer, dtype=old.dtype, device=old.device)
        spec["flow_probabilities"] = Bounded(
            0.0, 1.0, shape=(*batch, self.num_flows), dtype=torch.float32, device=old.device
        )
        spec["flow_class"] = Categorical(self.num_flows, shape=batch, device=old.device)
        return spec


class PredictedFlowLabel(FlowLabelTransform):
    """Write the flow label predicted by a lateral-line classifier.

    Evidence accumulates over the episode as in a Bayesian filter: the classifier's probabilities p
    count as likelihoods, and b <- p ((1 - s) b^memory / sum(b^memory) + s / n), normalised. With
    ``memory`` 1 it is the exact filter of a hidden Markov model whose flow is redrawn at rate s
    per decision, and with s = 0 it never forgets; a lower ``memory`` flattens the previous
    belief (Raftery, Karny & Ettler 2010). See ``FlowLabelTransform`` for the entries.

    Args:
        classifier: a ``fishrl.modules.LateralLineClassifier``, say, which maps the signal to logits
            ``[B, n]``. Its weights are frozen.
        num_flows: number of flows n.
        memory: in [0, 1]; 0 uses the current signal only, as the paper does.
        switching_rate: s in [0, 1], probability that the flow is redrawn before a decision.
        interpolates: write the mean of the labels as ``flow_class``, float32, instead of the most
            probable one: an estimate of the stream's speed, at which the rows of frequencies are
            interpolated.
        in_key: key of the signal ``[B, W, P, F]``.
        is_observed: see ``FlowLabelTransform``.
    """

    evidence: Tensor

    def __init__(
        self,
        *,
        classifier: nn.Module,
        num_flows: int,
        memory: float = 0.7,
        switching_rate: float = 0.0,
        interpolates: bool = False,
        in_key: str = "lateral_line",
        is_observed: bool = True,
    ) -> None:
        super().__init__(num_flows=num_flows, in_key=in_key, is_observed=is_observed)
        self.classifier = classifier.eval().requires_grad_(False)
        self.memory, self.switching_rate = memory, switching_rate
        self.interpolates = interpolates
        self.register_buffer("evidence", torch.zeros(0, self.num_flows))

    def set_container(self, container: Transform | EnvBase) -> None:
        """Attach to an environment, and clear the evidence of each row."""
        super().set_container(container)
        if (env := self.container) is not None:
            self.evidence = torch.zeros(*env.batch_size, self.num_flows, device=env.device)

    def compute_probabilities(self, now: TensorDictBase, *, begins: Tensor | None) -> Tensor:
        """Return the probabilities ``[B, n]`` given all signals of the episode so far."""
        log_prob = self.classifier(now[self.in_keys[0]]).float().log_softmax(-1)
        if begins is None:
            belief = self.memory * self.evidence  # before this signal
            if rate := self.switching_rate:
                belief = ((1.0 - rate) * belief.softmax(-1) + rate / self.num_flows).log()
            self.evidence = belief + log_prob
        else:
            self.evidence = torch.where(begins.unsqueeze(-1), log_prob, self.evidence)
        return self.evidence.softmax(-1)

    def choose_label(self, probabilities: Tensor) -> Tensor:
        """Return the most probable label ``[B]``, int64, or the mean of all, float32."""
        if not self.interpolates:
            return super().choose_label(probabilities)
        mean = probabilities @ torch.arange(self.num_flows).to(probabilities)
        return mean.clamp(max=self.num_flows - 1.0)  # rounding may exceed it

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Add the new entries; an interpolated label lies between 0 and ``num_flows`` - 1."""
        spec: Any = super().transform_observation_spec(observation_spec)
        if self.interpolates:
            most, device = self.num_flows - 1.0, spec["flow_class"].device
            spec["flow_class"] = Bounded(
                0.0, most, shape=spec.shape, dtype=torch.float32, device=device
            )
        return spec


class TrueFlowLabel(FlowLabelTransform):
    """Write the true flow label (the oracle); see ``FlowLabelTransform`` for the entries.

    It is the upper bound for a classifier, and serves to collect its training data.

    Args:
        num_flows: number of flows n.
        is_observed: see ``FlowLabelTransform``.
    """

    def __init__(self, *, num_flows: int, is_observed: bool = True) -> None:
        super().__init__(num_flows=num_flows, in_key="flow_index", is_observed=is_observed)

    def compute_probabilities(self, now: TensorDictBase, *, begins: Tensor | None) -> Tensor:
        """Return the one-hot true flow ``[B, n]``."""
        index = now["flow_index"].reshape(now.batch_size)
        return one_hot(index, self.num_flows).float()
