"""Flows side by side on the cores of a CPU: one process per core, one flow at a time in each.

Flows are independent between two actions, so each core can run its own flow for all steps of an
action. That keeps the flow in the core's cache and needs no synchronisation inside a step, where
two threads sharing one flow wait for each other at every call. State lies in shared memory; workers
only advance it, everything else happens in the parent while they wait. A worker is a plain
subprocess (not ``multiprocessing``, which would import the caller's script again).
"""

import logging
import mmap
import os
import pickle
import signal
import subprocess
import sys
import tempfile
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from typing import IO, Any

import torch
from torch import Tensor

from fishrl.children import CAN_START, start_child
from fishrl.physics.fast.batch import FlowBatch
from fishrl.physics.flow import FlowConfig


def open_shared() -> IO[bytes]:
    """Open an anonymous file in memory, which vanishes with its last user."""
    if sys.platform == "linux":
        return os.fdopen(os.memfd_create("fishrl"), "w+b")
    return tempfile.TemporaryFile()


class SharedMemory:
    """Blocks in a file, of zeros at first: what processes ask for in equal order they share."""

    def __init__(self, file: int) -> None:
        self._file, self._end = file, 0

    def __call__(self, num_bytes: int) -> Tensor:
        """Return the next block ``[num_bytes]``."""
        begin, unit = self._end, mmap.ALLOCATIONGRANULARITY
        self._end += -(-num_bytes // unit) * unit
        if os.fstat(self._file).st_size < self._end:
            os.ftruncate(self._file, self._end)
        return torch.frombuffer(mmap.mmap(self._file, num_bytes, offset=begin), dtype=torch.uint8)


def can_send(configs: Sequence[FlowConfig]) -> bool:
    """Return whether workers can start and import the flows' classes; none of a script."""
    try:
        return CAN_START and b"__main__" not in pickle.dumps(configs)
    except (AttributeError, TypeError, pickle.PicklingError):  # a class within a function
        return False


class Workers:
    """Subprocesses that share the flows which advance; ``wait`` until they can.

    Args:
        configs: configuration of each flow.
        group_size: flows per group.
        file: descriptor of the shared memory.
        count: number of workers.
        compile: whether to compile the step.
    """

    def __init__(
        self,
        configs: Sequence[FlowConfig],
        *,
        group_size: int,
        file: int,
        count: int,
        compile: bool,
    ) -> None:
        self._processes: list[subprocess.Popen[bytes]] = []
        for _ in range(count):
            process = _start("serve", stdout=subprocess.PIPE, pass_fds=[file])
            self._processes.append(process)
            _send(process.stdin, (configs, group_size, file, compile))

    def advance_(self, num_steps: int, groups: Collection[int]) -> None:
        """Advance the flows of ``groups``, and wait for the workers."""
        if not self._processes:
            raise ChildProcessError("the flow workers have ended: make a new solver")
        wanted, count = sorted(groups), len(self._processes)
        try:
            for first, process in enumerate(self._processes):
                _send(process.stdin, (num_steps, wanted[first::count]))
            self.wait()
        except BaseException:  # as by Ctrl-C: an answer not read would stand for the next request
            self.close()
            raise

    def wait(self) -> None:
        """Wait until every worker has compiled the step, or advanced.

        Raises:
            ChildProcessError: if one fails; all have ended then.
        """
        for process in self._processes:
            try:
                problem = pickle.load(process.stdout)  # type: ignore[arg-type]
            except EOFError:
                code = process.wait()
                problem = f"it ended with exit status {code}; see its own message above"
                if code == -signal.SIGKILL:
                    problem = "it was killed, probably because memory ran out"
            if problem is not None:
                self.close()
                raise ChildProcessError(f"a flow worker failed: {problem}")

    def close(self) -> None:
        """End the workers."""
        for process in self._processes:
            process.communicate()  # closes the pipe to it, which ends it
        self._processes = []

    def __del__(self) -> None:
        """End the workers with their owner."""
        self.close()


@contextmanager
def compiling_aside(configs: Sequence[FlowConfig]) -> Iterator[None]:
    """Let another process compile parts of a single flow's step, while this one does too."""
    process = _start("compile_aside")
    try:
        _send(process.stdin, configs)
        yield
    finally:
        process.communicate()  # ends it


def _start(function: str, **options: Any) -> subprocess.Popen[bytes]:
    code = f"from fishrl.physics.fast.workers import {function}; {function}()"
    one_thread = {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
    return start_child(code, env=os.environ | one_thread, **options)


def _send(pipe: IO[bytes] | None, message: object) -> None:
    assert pipe is not None
    try:
        pickle.dump(message, pipe)
        pipe.flush()
    except BrokenPipeError:
        pass  # the process is gone; waiting for its answer says so


def _begin() -> None:
    torch.set_num_threads(1)
    torch.set_flush_denormal(True)
    logging.basicConfig(level=logging.WARNING)


def compile_aside() -> None:
    """Compile what the parent has not begun to compile."""
    configs = pickle.load(sys.stdin.buffer)
    _begin()
    batch = FlowBatch(
        configs,
        group_size=1,
        device=torch.device("cpu"),
        allocate=partial(torch.zeros, dtype=torch.uint8),
    )
    with suppress(OSError):  # of the compiler: the parent meets the same
        batch.compile(with_check=True, helps=True)


def serve() -> None:
    """Run one worker: attach, then advance on demand until the parent closes the pipe."""
    requests, answers = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # nothing but answers may go to the pipe
    configs, group_size, file, compile = pickle.load(requests)
    _begin()
    batch = FlowBatch(
        configs, group_size=group_size, device=torch.device("cpu"), allocate=SharedMemory(file)
    )
    try:
        if compile:
            batch.compile(with_check=False)
    except OSError as error:  # of the compiler
        _send(answers, str(error))
        return
    _send(answers, None)
    while True:
        try:
            num_steps, wanted = pickle.load(requests)
        except EOFError:
            return
        batch.advance_(num_steps, wanted)
        _send(answers, None)
