"""Transforms that TorchRL lacks: the flow that the fish is in, named from its lateral line."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torch.nn.functional import one_hot
from torchrl.data import Bounded, Categorical, Composite, TensorSpec, Unbounded
from torchrl.envs import CatFrames, EnvBase, Transform

LATERAL_LINE = "lateral_line"
HISTORY = "lateral_line_history"


class NameFlow(Transform):
    """Say which flow each fish is in; what the two ways of knowing it have in common.

    Writes ``flow_probabilities`` ``[B, n]`` and ``flow_class`` ``[B]`` (int64, the likeliest), by
    which the environment picks the row of frequencies at the next step, and appends the
    probabilities to ``observation``. It belongs before the frames are stacked.

    A brain that learns in one flow alone should not observe them: numbers that never change while
    it learns have weights that nobody has trained, which another flow then brings into play.

    Args:
        num_flows: n.
        in_key: what the probabilities are made of.
        is_observed: append them to the observation.
    """

    def __init__(self, *, num_flows: int, in_key: str, is_observed: bool = True) -> None:
        observed = ["observation"] if is_observed else []
        super().__init__(
            in_keys=[in_key, *observed],
            out_keys=["flow_probabilities", "flow_class", *observed],
        )
        self.num_flows, self.is_observed = num_flows, is_observed

    @abstractmethod
    def compute_probabilities(self, now: TensorDictBase, *, begins: Tensor | None) -> Tensor:
        """Return the probability of each flow ``[B, n]``, float32.

        Args:
            now: what the environment shows.
            begins: ``[B]`` bool, the rows whose episode begins, at a reset, which leaves the others
                as they are; None after a step of all rows.
        """

    def set_container(self, container: Transform | EnvBase) -> None:
        """Attach to an environment, if its flows and sensors are the right ones.

        Raises:
            ValueError: if they are not.
        """
        super().set_container(container)
        env = self.container
        if env is not None:
            self.check_task(getattr(env.base_env, "task", None))

    def check_task(self, task: Any) -> None:
        """Refuse a task that has other flows.

        Raises:
            ValueError: if so, or if it has none to tell apart.
        """
        flows = getattr(task, "flow_labels", ())
        if len(flows) != self.num_flows:
            raise ValueError(
                f"{type(task).__name__} has {len(flows)} flows to tell apart, here "
                f"{self.num_flows} are expected: take a task with `flow_labels`, as many as that"
            )

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
        now.set("flow_class", probabilities.argmax(-1))
        if self.is_observed:
            old = now["observation"]
            now.set("observation", torch.cat((old, probabilities.to(old.dtype)), -1))
        return now

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Add the new entries, and lengthen the observation if it has them too."""
        assert isinstance(observation_spec, Composite)  # what an environment has
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


class RecogniseFlow(NameFlow):
    """Let a lateral-line machine say which flow it is; see ``NameFlow`` for what is written.

    A flow does not change from one decision to the next, so what the machine said before counts
    too: log-probabilities add up over the episode, those of k decisions ago times
    ``memory`` to the power of k.

    Args:
        machine: a ``fishrl.modules.LateralLineClassifier``, which is frozen by this; or a network
            like it, with ``num_flows`` and ``check``.
        memory: in [0, 1]; 0 believes the present signal alone, as the paper's machine does.
        in_key: its signal ``[B, W, P, F]``.
        is_observed: see ``NameFlow``.

    Raises:
        ValueError: if the memory is none.
    """

    evidence: Tensor

    def __init__(
        self,
        *,
        machine: nn.Module,
        memory: float = 0.7,
        in_key: str = LATERAL_LINE,
        is_observed: bool = True,
    ) -> None:
        if not 0.0 <= memory <= 1.0:
            raise ValueError(f"memory = {memory}: must lie in [0, 1]")
        num_flows: int = machine.num_flows  # type: ignore[assignment]
        super().__init__(num_flows=num_flows, in_key=in_key, is_observed=is_observed)
        self.machine = machine.eval().requires_grad_(False)
        self.memory = memory
        self.register_buffer("evidence", torch.zeros(0, self.num_flows))

    def set_container(self, container: Transform | EnvBase) -> None:
        """Attach to an environment, if its flows and sensors are the right ones.

        Raises:
            ValueError: if they are not.
        """
        super().set_container(container)
        env = self.container
        if env is not None:
            self.evidence = torch.zeros(*env.batch_size, self.num_flows, device=env.device)

    def check_task(self, task: Any) -> None:
        """Refuse a task whose flows or sensors the machine was not trained for.

        Raises:
            ValueError: naming what differs.
        """
        if not hasattr(task, "flow_labels") or not hasattr(task, "lateral_line_layout"):
            raise ValueError(
                f"{type(task).__name__} has no lateral line to recognise flows by: take a task "
                "with `flow_labels` and `lateral_line_layout`, such as KarmanGait"
            )
        self.machine.check(  # type: ignore[operator]
            flows=task.flow_labels, sensors=task.lateral_line_layout
        )

    def compute_probabilities(self, now: TensorDictBase, *, begins: Tensor | None) -> Tensor:
        """Return what the machine says, after what it said before ``[B, n]``."""
        said = self.machine(now[self.in_keys[0]]).float().log_softmax(-1)
        if begins is None:
            evidence = self.memory * self.evidence + said
        else:
            evidence = torch.where(begins.unsqueeze(-1), said, self.evidence)
        self.evidence = evidence
        return evidence.softmax(-1)


class KnowFlow(NameFlow):
    """Tell the fish which flow it really is in; see ``NameFlow`` for what is written.

    The oracle to measure a lateral-line machine by, and the way to collect data for one.

    Args:
        num_flows: n.
        is_observed: see ``NameFlow``.
    """

    def __init__(self, *, num_flows: int, is_observed: bool = True) -> None:
        super().__init__(num_flows=num_flows, in_key="flow_index", is_observed=is_observed)

    def compute_probabilities(self, now: TensorDictBase, *, begins: Tensor | None) -> Tensor:
        """Return 1 for the true flow ``[B, n]``."""
        index = now["flow_index"].reshape(now.batch_size)
        return one_hot(index, self.num_flows).float()


def make_recognition(
    machine: nn.Module, *, memory: float = 0.7, is_observed: bool = True
) -> list[Transform]:
    """Return the transforms by which a machine recognises flows, in order.

    A machine that reads more than one control interval gets the signals of several, one after the
    other, as ``lateral_line_history``; at the start of an episode its first signal is repeated.

    Args:
        machine: see ``RecogniseFlow``.
        memory: see ``RecogniseFlow``.
        is_observed: see ``NameFlow``.

    Raises:
        ValueError: if the memory is none.
    """
    settings: dict[str, Any] = {"machine": machine, "memory": memory, "is_observed": is_observed}
    num_intervals = int(machine.num_intervals)  # type: ignore[arg-type]
    if num_intervals == 1:
        return [RecogniseFlow(**settings)]
    return [
        CatFrames(N=num_intervals, dim=-3, in_keys=[LATERAL_LINE], out_keys=[HISTORY]),
        RecogniseFlow(**settings, in_key=HISTORY),
    ]
