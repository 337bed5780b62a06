"""Give every Python process the pretended device, where ``PRETEND_CUDA=1`` asks for it.

Triton's kernels are interpreted there. A torch that was built with CUDA is left alone.
"""

import os
import sys
from importlib.util import find_spec
from pathlib import Path

if os.environ.get("PRETEND_CUDA") == "1":
    spec = find_spec("torch")
    if spec is not None and not (Path(str(spec.origin)).parent / "lib/libtorch_cuda.so").exists():
        sys.path.insert(0, os.path.dirname(__file__))
        import device

        device.install()
        os.environ.setdefault("TRITON_INTERPRET", "1")
        os.environ.setdefault("TORCH_WARM_POOL", "0")  # no processes that would compile for it
