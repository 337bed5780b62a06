"""Comparison of the memory of flows, buffers and networks with that of the machine."""

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode

from fishrl.limits import measure_machine_memory


class Weightless(TorchFunctionMode):
    """Context in which modules have weights on device "meta", which take no memory.

    Conditions on tensors are true: TorchRL tests whether the weight of a critic is positive.
    """

    def __torch_function__(
        self, func: Callable[..., Any], types: Any, args: Any = (), kwargs: Any = None
    ) -> Any:
        """Call a function of torch."""
        if func is Tensor.__bool__:
            return True
        device = {"device": "meta"} if func is torch.empty else {}
        return func(*args, **(kwargs or {}) | device)


def check_memory(*, device: torch.device | str = "cpu", **needed: float) -> None:
    """Raise ValueError if parts do not fit into the memory of ``device`` together.

    ``needed`` are lower bounds of their sizes, bytes.
    """
    total = sum(needed.values())
    if torch.device(device).type == "cuda":
        size = float(torch.cuda.get_device_properties(device).total_memory)
    else:
        size = measure_machine_memory()
    if total > size:
        parts = ", ".join(f"{name} {part / 1e9:.3g} GB" for name, part in needed.items())
        raise ValueError(
            f"{parts}: more than the {size / 1e9:.3g} GB of {device}; lower their number or size"
        )
