"""Hand-written fish that hold a station by their tail beat alone.

They read what the learned fish reads: ``observation`` ``[B, n]``, of which the first four numbers
are x and y of the nose behind the obstacle and their change since the last decision, in body
lengths; ``action_mask``; and what the environment reports. A wish says which frequency (beats per
T) a fish would like; ``GaitPolicy`` takes the action that brings it nearest to that.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor


class Wish(ABC):
    """Which frequency a fish would like."""

    @abstractmethod
    def __call__(self, tensordict: TensorDictBase, flow: Tensor) -> Tensor:
        """Return beats per T ``[B]``, float64; may be infinite.

        Args:
            tensordict: ``[B]`` what the fish sees.
            flow: ``[B]`` which flow it believes to be in.
        """


class FixedFrequency(Wish):
    """Always the same: 0 is a passive fish, a flow's shedding frequency one in step with it.

    Args:
        frequency: beats per T, one number or one per flow.
    """

    def __init__(self, frequency: float | Sequence[float]) -> None:
        self.frequency = torch.as_tensor(frequency, dtype=torch.float64)

    def __call__(self, tensordict: TensorDictBase, flow: Tensor) -> Tensor:
        """Return the frequency."""
        frequency = self.frequency.to(flow.device)
        return frequency[flow] if frequency.dim() else frequency.expand(flow.shape)


class BangBang(Wish):
    """As fast as can be behind the station, as slowly as can be before it.

    Args:
        station_bl: x to hold, body lengths.
    """

    def __init__(self, *, station_bl: float = 2.1) -> None:
        self.station_bl = station_bl

    def __call__(self, tensordict: TensorDictBase, flow: Tensor) -> Tensor:
        """Return infinity or 0."""
        is_behind = tensordict["observation"][..., 0] > self.station_bl
        return torch.where(is_behind, torch.inf, 0.0).double()


class PID(Wish):
    """Faster the farther behind the station, the faster it falls back, and the longer it was so.

    Args:
        station_bl: x to hold, body lengths, one number or ``[B]``.
        frequency: beats per T at the station at rest, one number or one per flow.
        gain: beats per T and body length.
        integral_gain: beats per T and body length and decision.
        damping: beats per T and body length per decision.
        max_sum: bound of the summed offset, body lengths.
    """

    def __init__(
        self,
        *,
        station_bl: float | Tensor = 2.1,
        frequency: float | Sequence[float] = 1.0,
        gain: float = 2.0,
        integral_gain: float = 0.0,
        damping: float = 5.0,
        max_sum: float = 5.0,
    ) -> None:
        self.station_bl = station_bl
        self.frequency = torch.as_tensor(frequency, dtype=torch.float64)
        self.gain, self.integral_gain, self.damping = gain, integral_gain, damping
        self.max_sum = max_sum
        self._sum = torch.zeros(())

    def __call__(self, tensordict: TensorDictBase, flow: Tensor) -> Tensor:
        """Return the frequency; the sum begins anew with each episode (``is_init``)."""
        observation = tensordict["observation"]
        offset, change = observation[..., 0] - self.station_bl, observation[..., 2]
        is_new = tensordict["is_init"].reshape(offset.shape)
        before = self._sum if self._sum.shape == offset.shape else torch.zeros_like(offset)
        total = offset + torch.where(is_new, torch.zeros_like(offset), before)
        self._sum = total.clamp(-self.max_sum, self.max_sum)
        frequency = self.frequency.to(flow.device)
        frequency = frequency[flow] if frequency.dim() else frequency
        wish = frequency + self.gain * offset + self.damping * change
        return (wish + self.integral_gain * self._sum).double()


class GaitPolicy(TensorDictModuleBase):
    """A fish that acts towards the frequency it wishes for.

    Args:
        wish: which frequency.
        rows: frequencies that each flow offers, rising, one row per flow; with direct choice one.
        is_direct: an action is an index into the one row; else it is decelerate (0), cruise (1) or
            accelerate (2) from the present ``gear``.
        flow_key: which row applies, ``[B]`` or ``[B, 1]``; ``flow_class`` is what a machine says.

    Raises:
        ValueError: if there is no row, or more than one for a direct choice.
    """

    def __init__(
        self,
        *,
        wish: Wish,
        rows: Sequence[Sequence[float]],
        is_direct: bool = False,
        flow_key: str = "flow_index",
    ) -> None:
        super().__init__()
        if not rows or (is_direct and len(rows) != 1):
            raise ValueError(
                f"rows = {rows}: give one row per flow, and with is_direct exactly one row"
            )
        self.wish, self.is_direct, self.flow_key = wish, is_direct, flow_key
        self.in_keys = ["observation", "is_init", "gear", flow_key]
        self.out_keys = ["action"]
        self.rows = torch.tensor(rows, dtype=torch.float64)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``action`` ``[B]``; it is always legal."""
        batch = tensordict.batch_size
        flow = tensordict[self.flow_key].reshape(batch)
        rows = self.rows.to(flow.device)
        row = rows[0].expand(*batch, -1) if self.is_direct else rows[flow]
        wish = self.wish(tensordict, flow).clamp(rows.min(), rows.max())
        action = (row - wish[..., None]).abs().argmin(-1)
        if not self.is_direct:
            action = 1 + (action - tensordict["gear"].reshape(batch)).sign()
        return tensordict.set("action", action)
