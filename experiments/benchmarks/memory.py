"""Group ``memory``: bytes that a flow takes, per node."""

from __future__ import annotations

import gc
from typing import Any

import torch

from experiments.benchmarks.alone import run_alone
from experiments.benchmarks.entry import Settings
from experiments.benchmarks.flows import describe_size, make_scales, make_tank
from fishrl.physics import InPlaceSolver


def count_tensor_bytes() -> int:
    """Return the bytes of all storages that tensors of this process hold, each once."""
    gc.collect()
    storages = {}
    for thing in gc.get_objects():
        if issubclass(type(thing), torch.Tensor):  # isinstance would wake deprecated things
            storage = thing.untyped_storage()
            storages[storage.data_ptr()] = storage.nbytes()
    return sum(storages.values())


def measure_bytes(*, body_length: int, has_fish: bool, num_flows: int) -> dict[str, Any]:
    """Make flows in this process, and return what they take per node: state, scratch and tables."""
    before = count_tensor_bytes()
    scales = make_scales(body_length)
    config = make_tank(scales, has_fish=has_fish)
    solver = InPlaceSolver(config=config, num_envs=num_flows, compile=False, num_workers=0)
    solver.advance_(2)
    num_nodes = num_flows * config.width * config.height
    return {
        "name": f"{describe_size(config, num_flows)}, {'a fish in each' if has_fish else 'walls'}",
        "bytes_per_node": (count_tensor_bytes() - before) / num_nodes,
        "state_bytes_per_node": sum(t.nbytes for t in solver.state_dict().values()) / num_nodes,
    }


def run(settings: Settings) -> dict[str, Any]:
    """Measure the large flow, and batches of the middle one."""
    large, middle = settings.body_length, settings.body_length // 2
    return {
        "rows": [
            run_alone(measure_bytes, body_length=length, has_fish=has_fish, num_flows=num_flows)
            for length, has_fish, num_flows in (
                (large, False, 1),
                (large, True, 1),
                (middle, True, 1),
                (middle, True, 16),
            )
        ]
    }
