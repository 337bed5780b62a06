"""Flows side by side on the cores of a CPU: one process per core, one flow at a time in each.

Flows are independent between two actions, so each core can run its own flow for all steps of an
action. That keeps the flow in the core's cache and needs no synchronisation inside a step, where
two threads sharing one flow wait for each other at every call. State lies in shared memory; workers
only advance it, everything else happens in the parent while they wait. A worker is a plain
subprocess (not ``multiprocessing``, which would import the caller's script again).
"""

import logging
import os
import pickle
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import IO, NamedTuple

import torch
from torch import Tensor

from fishrl.physics.fast.batch import FlowBatch
from fishrl.physics.flow import FlowConfig

logger = logging.getLogger(__name__)


class SharedMemory:
    """A zeroed block of memory that workers can map; it vanishes with its last user.

    Args:
        num_bytes: size of the block.
    """

    def __init__(self, num_bytes: int) -> None:
        folder = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
        handle, name = tempfile.mkstemp(prefix="fishrl-", dir=folder)
        os.ftruncate(handle, num_bytes)
        os.close(handle)
        self.path = Path(name)
        self.tensor = map_shared(name, num_bytes)

    def unlink(self) -> None:
        """Remove the name; those who mapped the block keep it."""
        self.path.unlink(missing_ok=True)

    def __del__(self) -> None:
        """Leave no file where no worker was ever started."""
        self.unlink()


def map_shared(path: str, num_bytes: int) -> Tensor:
    """Return the block at ``path`` as bytes ``[num_bytes]``, shared with all who map it."""
    return torch.from_file(path, shared=True, size=num_bytes, dtype=torch.uint8)


def count_cores() -> int:
    """Return how many cores this process may use, as ``taskset`` or a cluster gave them."""
    given = getattr(os, "sched_getaffinity", None)  # Linux
    return len(given(0)) if given else os.cpu_count() or 1


class Job(NamedTuple):
    """What a worker is sent.

    Attributes:
        configs: of all flows.
        group_size: flows per group.
        path: of the shared memory.
        groups: that this worker advances.
        compile: whether to compile the step.
    """

    configs: Sequence[FlowConfig]
    group_size: int
    path: str
    groups: range
    compile: bool


class Workers:
    """Subprocesses that advance their share of the flows.

    Args:
        jobs: one per worker.
    """

    def __init__(self, jobs: Sequence[Job]) -> None:
        command = [sys.executable, "-c", "from fishrl.physics.fast.workers import serve; serve()"]
        root = str(Path(__file__).parents[3])
        path = os.pathsep.join([root, *filter(None, [os.environ.get("PYTHONPATH")])])
        env = os.environ | {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "PYTHONPATH": path}
        self._processes = [
            subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=env)
            for _ in jobs
        ]
        for process, job in zip(self._processes, jobs, strict=True):
            _send(process.stdin, job)
        self._wait()

    def advance_(self, num_steps: int, groups: Sequence[int]) -> None:
        """Advance those of the workers' flows that are in ``groups``, and wait for them."""
        for process in self._processes:
            _send(process.stdin, (num_steps, frozenset(groups)))
        self._wait()

    def _wait(self) -> None:
        for process in self._processes:
            try:
                answer = pickle.load(process.stdout)  # type: ignore[arg-type]
            except EOFError:
                answer = f"it ended with exit status {process.wait()}"
            if answer is not None:
                self.close()
                raise RuntimeError(
                    f"a flow worker failed: {answer}; its own message stands above. Use "
                    "num_workers=0 to run the flows in this process"
                )

    def close(self) -> None:
        """End the workers."""
        for process in self._processes:
            if process.stdin:
                process.stdin.close()
            process.terminate()
        for process in self._processes:
            process.wait()
            if process.stdout:
                process.stdout.close()
        self._processes = []

    def __del__(self) -> None:
        """End the workers with their owner."""
        self.close()


def _send(pipe: IO[bytes] | None, message: object) -> None:
    assert pipe is not None
    try:
        pickle.dump(message, pipe)
        pipe.flush()
    except BrokenPipeError:
        pass  # the worker is gone; waiting for its answer says so


def serve() -> None:
    """Run one worker: attach, then advance on demand until the parent closes the pipe."""
    requests, answers = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # nothing but answers may go to the pipe
    torch.set_num_threads(1)
    torch.set_flush_denormal(True)
    job: Job = pickle.load(requests)
    logging.basicConfig(level=logging.WARNING)
    batch = FlowBatch(
        job.configs,
        group_size=job.group_size,
        device=torch.device("cpu"),
        allocate=partial(map_shared, job.path),
        groups=job.groups,
    )
    if job.compile:
        batch.stepper.compile()
    _send(answers, None)
    while True:
        try:
            num_steps, groups = pickle.load(requests)
        except EOFError:
            return
        batch.advance_(num_steps, groups)
        _send(answers, None)
