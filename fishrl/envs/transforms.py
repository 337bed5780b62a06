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
    probabilities to ``observation``. It keeps nothing from one step to the next. It belongs before
    the frames are stacked.

    Args:
        num_flows: n.
        in_key: what the probabilities are made of.
    """

    def __init__(self, *, num_flows: int, in_key: str) -> None:
        super().__init__(
            in_keys=[in_key, "observation"],
            out_keys=["flow_probabilities", "flow_class", "observation"],
        )
        self.num_flows = num_flows

    @abstractmethod
    def compute_probabilities(self, tensordict: TensorDictBase) -> Tensor:
        """Return the probability of each flow ``[*batch, n]``, float32."""

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

    @torch.no_grad()
    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        probabilities = self.compute_probabilities(next_tensordict)
        observation = next_tensordict["observation"]
        next_tensordict.set("flow_probabilities", probabilities)
        next_tensordict.set("flow_class", probabilities.argmax(-1))
        next_tensordict.set(
            "observation", torch.cat((observation, probabilities.to(observation.dtype)), -1)
        )
        return next_tensordict

    forward = _call

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return self._call(tensordict_reset)

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Add the new entries and lengthen the observation."""
        assert isinstance(observation_spec, Composite)  # what an environment has
        spec = observation_spec.clone()
        old, batch = spec["observation"], spec.shape
        longer = (*old.shape[:-1], old.shape[-1] + self.num_flows)
        spec["observation"] = Unbounded(longer, dtype=old.dtype, device=old.device)
        spec["flow_probabilities"] = Bounded(
            0.0, 1.0, shape=(*batch, self.num_flows), dtype=torch.float32, device=old.device
        )
        spec["flow_class"] = Categorical(self.num_flows, shape=batch, device=old.device)
        return spec


class RecogniseFlow(NameFlow):
    """Let a lateral-line machine say which flow it is; see ``NameFlow`` for what is written.

    Args:
        machine: a ``fishrl.modules.LateralLineMachine``, which is frozen by this; or a network
            like it, with ``num_flows`` and ``check``.
        in_key: its signal ``[B, W, P, F]``.
    """

    def __init__(self, *, machine: nn.Module, in_key: str = LATERAL_LINE) -> None:
        super().__init__(num_flows=int(machine.num_flows), in_key=in_key)  # type: ignore[arg-type]
        self.machine = machine.eval().requires_grad_(False)

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

    def compute_probabilities(self, tensordict: TensorDictBase) -> Tensor:
        """Return what the machine says ``[*batch, n]``."""
        logits: Tensor = self.machine(tensordict[self.in_keys[0]])
        return logits.float().softmax(-1)


class KnowFlow(NameFlow):
    """Tell the fish which flow it really is in; see ``NameFlow`` for what is written.

    The oracle to measure a lateral-line machine by, and the way to collect data for one.

    Args:
        num_flows: n.
    """

    def __init__(self, *, num_flows: int) -> None:
        super().__init__(num_flows=num_flows, in_key="flow_index")

    def compute_probabilities(self, tensordict: TensorDictBase) -> Tensor:
        """Return 1 for the true flow ``[*batch, n]``."""
        index = tensordict["flow_index"].reshape(tensordict.batch_size)
        return one_hot(index, self.num_flows).float()


def make_recognition(machine: nn.Module) -> list[Transform]:
    """Return the transforms by which a machine recognises flows, in order.

    A machine that reads more than one control interval gets the signals of several, one after the
    other, as ``lateral_line_history``; at the start of an episode its first signal is repeated.
    """
    num_intervals = int(machine.num_intervals)  # type: ignore[arg-type]
    if num_intervals == 1:
        return [RecogniseFlow(machine=machine)]
    return [
        CatFrames(N=num_intervals, dim=-3, in_keys=[LATERAL_LINE], out_keys=[HISTORY]),
        RecogniseFlow(machine=machine, in_key=HISTORY),
    ]
