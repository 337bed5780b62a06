"""Operations on TensorDicts whose rows belong to one flow each."""

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor


def merge(rows: Tensor, new: TensorDictBase, old: TensorDictBase) -> TensorDict:
    """Return ``new`` in ``rows`` ``[B]`` and ``old`` elsewhere."""
    return old.apply(
        lambda kept, fresh: torch.where(rows.view(-1, *(1,) * (kept.dim() - 1)), fresh, kept),
        new,
    )
