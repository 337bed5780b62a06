"""Checks of tensors that are given to a solver."""

import torch
from torch import Tensor


def check_tensor(
    name: str,
    value: object,
    shape: tuple[int | None, ...] | None = None,
    *,
    dtype: torch.dtype | None = None,
    where: Tensor | None = None,
) -> None:
    """Check shape (None fits any length), type and, in rows ``where`` ``[B]``, that it is finite.

    That is read on a CPU only: on a GPU the host would have to wait.
    """
    wanted = f"a tensor of shape {shape}" + (f" and type {dtype}" if dtype else "")
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
    if not value.to(where.device)[where].isfinite().all():
        raise ValueError(f"{name} = {value.tolist()}: must be finite in every chosen row")
