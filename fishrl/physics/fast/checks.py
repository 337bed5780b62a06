"""Checks of a solver's arguments."""

from collections.abc import Sequence
from math import inf

import torch
from torch import Tensor

from fishrl.memory import check_memory
from fishrl.physics.flow import FlowConfig
from fishrl.physics.lattice import Q


def check_tensor(
    name: str,
    value: object,
    shape: tuple[int | None, ...] | None = None,
    *,
    dtype: torch.dtype | None = None,
    where: Tensor | None = None,
    largest: float | Tensor = inf,
    reason: str = "",
) -> None:
    """Check shape (None fits any length), type and, in rows ``where`` ``[B]``, size.

    There it must be finite and of a magnitude of at most ``largest``, a number or as ``value``, for
    a ``reason``. That is read on a CPU only: on a GPU the host would have to wait.
    """
    wanted = "a tensor" + ("" if shape is None else f" of shape {shape}".replace("None", "any"))
    wanted += f" and type {dtype}" if dtype else ""
    if not isinstance(value, Tensor):
        raise ValueError(f"{name} = {value!r}: give {wanted}")
    sizes = value.shape if shape is None else shape
    is_fit = len(sizes) == value.dim() and all(
        size in (None, own) for size, own in zip(sizes, value.shape, strict=True)
    )
    if not is_fit or dtype not in (None, value.dtype):
        raise ValueError(
            f"{name} has shape {tuple(value.shape)} and type {value.dtype}: give {wanted}"
        )
    if where is None or where.device.type != "cpu":
        return
    value = value.to(where.device)
    every = where.view((*where.shape, *(1,) * (value.dim() - where.dim())))
    size = value.abs()
    fits = (size < inf) & (size <= largest * (1.0 + 1e-9))
    if (fits | ~every).all():
        return
    chosen = value[where]
    if not chosen.isfinite().all():
        raise ValueError(f"{name} = {value.tolist()}: must be finite in every chosen row")
    allowed = torch.as_tensor(largest, dtype=torch.float64).expand(value.shape)[where].min()
    raise ValueError(f"{name} = {value.tolist()}: allowed is at most {allowed:.4g}{reason}")


def check_populations(
    f: Tensor | Sequence[Tensor | None], config: FlowConfig, num: int
) -> Sequence[Tensor | None]:
    """Return populations ``[num, Q, Y, X]`` of each grid, None for what its parent fills."""
    every, sizes = [f] if isinstance(f, Tensor) else f, config.list_grids()
    if len(every) != len(sizes):
        raise ValueError(
            f"f has populations of {len(every)} grids, the flow has {len(sizes)}: give those of "
            "each, populations(grid=0), populations(grid=1) and so on"
        )
    for grid, (width, height, _) in enumerate(sizes):
        if every[grid] is not None or not grid:
            check_tensor("f", every[grid], (num, Q, height, width))
    return every


def read_frequency(frequency: float | Tensor | None, configs: Sequence[FlowConfig]) -> Tensor:
    """Return a frequency per step, by default 0, or one of each flow ``[B]``, float64 on the CPU.

    ValueError unless it is finite and no body's surface too fast.
    """
    frequency = 0.0 if frequency is None else frequency
    value = torch.as_tensor(frequency, dtype=torch.float64, device="cpu")
    shape = (len(configs),) if value.dim() else ()
    check_tensor("frequency", value, shape, where=torch.ones(shape, dtype=torch.bool))
    for config, own in zip(configs, value.expand(len(configs)).tolist(), strict=True):
        for body in config.bodies:
            body.check_speed(own)
    return value


def check_device(device: torch.device | str) -> None:
    """Raise ValueError unless this machine has a device: ``cpu``, ``cuda``, ``cuda:<number>``."""
    num_devices = torch.cuda.device_count()
    known = ["cpu", *["cuda"][:num_devices], *(f"cuda:{i}" for i in range(num_devices))]
    if str(device) not in known:
        raise ValueError(
            f"device = {str(device)!r}: must be cpu, cuda or cuda:<number>, and torch sees "
            f"{num_devices} CUDA devices here; take device=cpu, or install a CUDA build of torch "
            "and its driver"
        )


def list_configs(
    config: FlowConfig | Sequence[FlowConfig],
    num_envs: int | None,
    device: torch.device | str = "cpu",
) -> list[FlowConfig]:
    """Return one configuration per flow.

    Raises:
        ValueError: if there are not ``num_envs`` of them, or their populations exceed the memory.
    """
    if isinstance(config, FlowConfig):
        num_envs = 1 if num_envs is None else num_envs
        check_memory(device=device, flows=num_envs * config.num_bytes)
        return [config] * num_envs
    if not config or num_envs not in (None, len(config)):
        raise ValueError(
            f"num_envs = {num_envs} with {len(config)} configurations: give one per flow"
        )
    check_memory(device=device, flows=sum(one.num_bytes for one in config))
    return list(config)
