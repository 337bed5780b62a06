"""Streaming: every population moves to the next node along its velocity.

The in-place step needs no such pass: its addresses imply it, see ``fast/layout.py``.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from fishrl.physics.lattice import CX, CY


def stream(f: Sequence[Tensor]) -> list[Tensor]:
    """Move nine ``[B, Y, X]`` populations by one node along their velocity, periodically."""
    return [
        torch.roll(g, (cy, cx), (-2, -1)) if cx or cy else g.clone()
        for g, cx, cy in zip(f, CX, CY, strict=True)
    ]
