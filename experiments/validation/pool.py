"""Jobs side by side in processes of their own, one thread each; a job that dies harms no other."""

from __future__ import annotations

import json
import multiprocessing
import signal
import time
import traceback
from collections import deque
from collections.abc import Generator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from typing import Any, NamedTuple

from experiments.validation.case import Job, Result


class Done(NamedTuple):
    """What became of a job: its result, or why there is none."""

    result: Result | None
    error: str
    seconds: float


@dataclass
class Start:
    """A job has begun."""

    index: int


@dataclass
class Finish:
    """A job has ended."""

    index: int
    done: Done


class _Worker:
    """One process and the job it is at."""

    def __init__(self) -> None:
        # spawned, not forked: a fork of a process with threads (torch has some) may hang
        context = multiprocessing.get_context("spawn")
        self.connection, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs,), daemon=True)
        self.process.start()
        theirs.close()
        self.index: int | None = None

    def receive(self) -> Done:
        """Return what the process has to say about its job."""
        try:
            text, error, seconds = self.connection.recv()
        except (EOFError, ConnectionError):
            self.process.join()
            return Done(None, f"its process ended with exit status {self.process.exitcode}", 0.0)
        return Done(json.loads(text) if text else None, error, seconds)

    def close(self) -> None:
        """End the process, whatever it is at."""
        self.connection.close()
        self.process.terminate()
        self.process.join()


def run_jobs(jobs: Sequence[Job], *, num_workers: int) -> Generator[Start | Finish, None, None]:
    """Run jobs, the dearest first, and tell when each begins and ends.

    Args:
        jobs: what to run; events name them by their place in this sequence.
        num_workers: processes at a time.

    Closing the iterator, or an exception in the loop over it, ends all processes.
    """
    waiting = deque(sorted(range(len(jobs)), key=lambda i: -jobs[i].cost))
    idle: list[_Worker] = []
    busy: dict[Connection[Any, Any], _Worker] = {}
    try:
        while waiting or busy:
            while waiting and len(busy) < num_workers:
                worker = idle.pop() if idle else _Worker()
                worker.index = waiting.popleft()
                busy[worker.connection] = worker
                job = jobs[worker.index]
                with suppress(ConnectionError):  # it is gone: so its end is received
                    worker.connection.send((job.function, job.arguments))
                yield Start(worker.index)
            for connection in wait(list(busy)):
                assert isinstance(connection, Connection)
                worker = busy.pop(connection)
                assert worker.index is not None
                done = worker.receive()
                if worker.process.exitcode is None:
                    idle.append(worker)
                else:
                    worker.close()
                yield Finish(worker.index, done)
    finally:
        for worker in [*busy.values(), *idle]:
            worker.close()


def _serve(connection: Connection[Any, Any]) -> None:
    """Run the jobs that come in until the other side closes the pipe."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all; the parent decides
    import torch

    torch.set_num_threads(1)
    torch.set_flush_denormal(True)
    while True:
        try:
            function, arguments = connection.recv()
        except EOFError:
            return
        start = time.perf_counter()
        text, error = "", ""
        try:
            text = json.dumps(function(**arguments))
        except Exception as problem:  # noqa: BLE001 - whatever it is, it is this job's alone
            traceback.print_exc()
            error = f"{type(problem).__name__}: {problem}"
        connection.send((text, error, time.perf_counter() - start))
