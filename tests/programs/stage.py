"""Runs programs in processes of their own, at their start or held at a moment; see ``Stage``.

Programs are forked from a process that has imported them, so that a pair of them costs little.
"""

import importlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from fishrl.__main__ import list_programs

ROOT = Path(__file__).parents[2]
#: What Python reports of files: it is made, opened, renamed or removed.
EVENTS = {"open", "os.mkdir", "os.rename", "os.remove", "os.rmdir"}
WORKED = 99


def find_module(program: str) -> str:
    package = "fishrl.programs" if program in list_programs() else "experiments"
    return f"{package}.{program.replace('-', '_')}"


class Act:
    """A program that runs; ``out`` is what it prints."""

    def __init__(self, stage: "Stage", pid: int, out: Path) -> None:
        self._stage, self.pid, self._status, self._out = stage, pid, None, out

    @property
    def status(self) -> int | None:
        """Exit status, or None as long as it runs."""
        if self._status is None:
            self._status = self._stage.ask(poll=self.pid)
        return self._status

    @property
    def is_held(self) -> bool:
        return self._out.with_suffix(".held").exists()

    @property
    def said(self) -> str:
        return self._out.read_text(encoding="utf-8")

    def stop(self, *, after: float) -> None:
        """Stop it after some seconds."""
        time.sleep(after)
        with suppress(ProcessLookupError):
            os.kill(self.pid, signal.SIGSTOP)

    def let_go(self) -> None:
        self._out.with_suffix(".go").touch()
        with suppress(ProcessLookupError):
            os.kill(self.pid, signal.SIGCONT)

    def wait(self, *, until_held: bool = False, seconds: float = 800.0) -> None:
        """Wait until it has ended, or perhaps is held."""
        deadline = time.monotonic() + seconds
        while self.status is None and not (until_held and self.is_held):
            assert time.monotonic() < deadline, self.said
            time.sleep(0.01)


class Stage:
    """The process from which programs are forked; its ``folder`` takes what they print."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._num = folder, 0
        self._process = subprocess.Popen(
            [sys.executable, "-m", __name__],
            cwd=ROOT,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "OMP_NUM_THREADS": "1"},
        )

    def ask(self, **request: Any) -> Any:
        assert self._process.stdin and self._process.stdout
        print(json.dumps(request), file=self._process.stdin, flush=True)
        return json.loads(self._process.stdout.readline())

    def start(self, program: str, words: Sequence[str], *, folder: Path, **how: Any) -> Act:
        """Start a program in the ways of ``play``."""
        self._num += 1
        out = self._folder / f"{self._num}.txt"
        out.touch()
        request = {"program": program, "words": list(words), "out": str(out)}
        return Act(self, self.ask(**request, folder=str(folder), **how), out)

    def close(self) -> None:
        assert self._process.stdin and self._process.stdout
        self._process.stdin.close()
        self._process.wait()
        self._process.stdout.close()


def play(
    program: str, words: Sequence[str], out: str, folder: str,
    hold_at: int = 0, glides: bool = False, idles: bool = False,
) -> None:  # fmt: skip
    """Run a program in this process, and end it.

    It stops at its ``hold_at``-th touch of a file in the folder. With ``glides`` fish move without
    a flow; with ``idles`` it ends with status ``WORKED`` where it would advance one.
    """
    text = os.open(out, os.O_WRONLY | os.O_APPEND)
    os.dup2(text, 1)
    os.dup2(text, 2)
    count, here = 0, Path(out)
    sys.stdout = os.fdopen(1, "w", buffering=1)
    sys.stderr = os.fdopen(2, "w", buffering=1)

    def notice(event: str, arguments: tuple[Any, ...]) -> None:
        nonlocal count
        if event in EVENTS and str(arguments[0]).startswith(folder):
            count += 1
            if count == hold_at:
                here.with_suffix(".held").touch()
                while not here.with_suffix(".go").exists():
                    time.sleep(0.005)

    if glides:
        from tests.envs.conftest import move_kinematically

        move_kinematically(pytest.MonkeyPatch())
    if idles:
        from fishrl.envs.flow_env import FlowEnv
        from fishrl.physics import InPlaceSolver

        for kind, name in ((FlowEnv, "_step"), (InPlaceSolver, "advance_")):
            pytest.MonkeyPatch().setattr(kind, name, lambda *_, **__: os._exit(WORKED))
    sys.argv = [program, *words]
    sys.addaudithook(notice)
    importlib.import_module(find_module(program)).main()
    sys.exit()


def serve(programs: Sequence[str]) -> None:
    import torch

    torch.set_num_threads(1)
    for program in programs:
        importlib.import_module(find_module(program))
    answers = os.fdopen(os.dup(1), "w")
    for line in sys.stdin:
        request = json.loads(line)
        if "poll" in request:
            pid, status = os.waitpid(request["poll"], os.WNOHANG)
            answer = os.waitstatus_to_exitcode(status) if pid else None
        elif (answer := os.fork()) == 0:
            play(**request)
        print(json.dumps(answer), file=answers, flush=True)


if __name__ == "__main__":
    serve([*list_programs()])
