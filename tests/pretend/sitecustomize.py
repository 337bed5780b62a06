"""Give every Python process the pretended device, where ``PRETEND_CUDA=1`` asks for it."""

import os
import sys

if os.environ.get("PRETEND_CUDA") == "1":
    sys.path.insert(0, os.path.dirname(__file__))
    import device

    device.install()
