"""Group ``compile``: how long the first step takes, with nothing kept and with everything kept."""

from __future__ import annotations

import logging
import os
import tempfile
import time
from typing import Any

from experiments.benchmarks.alone import run_alone
from experiments.benchmarks.entry import Settings
from experiments.benchmarks.flows import make_scales, make_tank
from fishrl.physics import InPlaceSolver

logger = logging.getLogger(__name__)


def time_compilation(*, body_length: int, folder: str) -> dict[str, Any]:
    """Compile the step with a swimming fish in this process, and run it once.

    Args:
        body_length: L.
        folder: where compiled code is kept.
    """
    os.environ["TORCHINDUCTOR_CACHE_DIR"] = folder
    scales = make_scales(body_length)
    solver = InPlaceSolver(
        config=make_tank(scales, has_fish=True), frequency=1.0 / scales.period, num_workers=0
    )
    start = time.perf_counter()
    solver.compile()
    solver.advance_(2)
    return {"seconds": time.perf_counter() - start}


def run(settings: Settings) -> dict[str, Any]:
    """Compile in a process with an empty folder, and again in another with what that one left."""
    found: dict[str, Any] = {}
    with tempfile.TemporaryDirectory(prefix="fishrl-compile-") as folder:
        for name in ("cold", "warm"):
            logger.info("compile: %s ...", name)
            found[name] = run_alone(
                time_compilation, body_length=settings.body_length // 2, folder=folder
            )["seconds"]
    return found
