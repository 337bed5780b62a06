"""The fixed starts of evaluations."""

from typing import Any

import torch
from tensordict import TensorDict

#: Seeds of the starts that choose the best checkpoint and that end a run; training draws its starts
#: from generators far from both.
SELECTION_SEED, FINAL_SEED, TRAIN_SEED = 1, 0, 1000


def fixed_starts(task: Any, num: int, *, seed: int) -> TensorDict:
    """Draw the starts of an evaluation, the same for the same seed and number."""
    return task.sample_starts(num, torch.Generator().manual_seed(seed))
