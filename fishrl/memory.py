"""Comparison of the memory of flows and buffers with that of the machine."""

import torch

from fishrl.limits import measure_machine_memory


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
