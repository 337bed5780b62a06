"""Group ``gpu``: a batch that fills the card; left out where torch sees none."""

from __future__ import annotations

from collections.abc import Callable

import torch

from experiments.benchmarks.entry import PROBE, Entry, Settings, Team
from experiments.benchmarks.flows import CODE, make_entry, make_kernel_entry, make_solver
from fishrl.physics.storage import Storage

NUM_FLOWS = 64
HOW = "all in one launch"


def make_flows(*, body_length: int, num_flows: int) -> list[Entry]:
    """Make a batch with and without a fish in each, and a copy of the same size.

    Raises:
        ImportError: if torch sees no CUDA device.
    """
    if not torch.cuda.is_available():
        raise ImportError(f"torch {torch.__version__} sees no CUDA device")
    empty, fish, half = (
        make_solver(
            body_length=body_length,
            has_fish=has_fish,
            num_envs=num_flows,
            device="cuda",
            storage=storage,
        )
        for has_fish, storage in (
            (False, Storage.FLOAT32),
            (True, Storage.FLOAT32),
            (True, Storage.FLOAT16),
        )
    )
    source = torch.rand(9 * num_flows * empty.config.width * empty.config.height, device="cuda")
    target = torch.empty_like(source)

    def copy(num_steps: int) -> None:
        for _ in range(num_steps):
            target.copy_(source)

    kernel = make_kernel_entry(empty, label="gpu/kernel", how=HOW)
    return [
        Entry(
            label="gpu/copy",
            name=f"copy of {source.nbytes / 1e9:.2f} GB on the device",
            scope=PROBE,
            advance=wait_for(copy),
            num_nodes=len(source) // 9,
            working_set=2 * source.nbytes,
        ),
        Entry(**vars(kernel) | {"advance": wait_for(kernel.advance)}),
        make_entry(empty, label="gpu/walls", how=HOW),
        make_entry(fish, label="gpu/fish", how=HOW),
        make_entry(half, label="gpu/fish, half", how=f"{HOW}, half precision"),
    ]


def wait_for(advance: Callable[[int], object]) -> Callable[[int], None]:
    """Return ``advance`` with the wait until the device has done it."""

    def advance_and_wait(num_steps: int) -> None:
        advance(num_steps)
        torch.cuda.synchronize()

    return advance_and_wait


def list_teams(settings: Settings) -> list[Team]:
    """Return the process that uses the device."""
    arguments = {"body_length": settings.body_length // 2, "num_flows": NUM_FLOWS}
    return [Team(code=CODE, group="gpu", make=make_flows, arguments=arguments)]
