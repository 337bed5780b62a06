"""Storage format of populations: single precision, or half precision for bandwidth.

Arithmetic is always in single precision. Deviations f - w are stored, so that the eleven bits of
half precision resolve the flow and not the rest state; scaling by a power of two keeps small
deviations out of the denormals (the FP16S format of Lehmann et al. 2022).
"""

from enum import Enum

import torch
from torch import Tensor


class Storage(Enum):
    """A number format and the factor by which stored values are larger."""

    FLOAT32 = (torch.float32, 1.0)
    FLOAT16 = (torch.float16, 2.0**15)  # holds deviations below 2

    @property
    def dtype(self) -> torch.dtype:
        """Type in memory."""
        return self.value[0]

    @property
    def scale(self) -> float:
        """Factor by which stored values are larger."""
        return self.value[1]

    def decode(self, stored: Tensor) -> Tensor:
        """Return populations from memory."""
        return stored if self.scale == 1.0 else stored.float() * (1.0 / self.scale)

    def encode(self, f: Tensor) -> Tensor:
        """Return populations as stored."""
        return f.to(self.dtype) if self.scale == 1.0 else (f * self.scale).to(self.dtype)
