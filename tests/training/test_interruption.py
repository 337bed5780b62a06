"""Signals: the first saves and ends a run, a second one ends it at once."""

import os
import pty
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

import pytest

from fishrl.training.interruption import (
    SIGNALS,
    Interrupted,
    Interruption,
    exit_status,
    handling_signals,
    ignore_signals_in_children,
)


@pytest.mark.usefixtures("heeds_ctrl_c")
def test_second_signal_ends_a_run_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    interruption, before = Interruption(), signal.getsignal(signal.SIGINT)
    interruption.check()
    with handling_signals(interruption.handle):
        signal.raise_signal(signal.SIGTERM)
        signal.raise_signal(signal.SIGTERM)  # the same twice at once counts as one
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        monkeypatch.setattr("fishrl.training.interruption.TWICE_SECONDS", 0.0)
        with pytest.raises(KeyboardInterrupt) as end:
            signal.raise_signal(signal.SIGTERM)
        assert exit_status(end.value) == 143
    assert exit_status(KeyboardInterrupt()) == 130
    assert signal.getsignal(signal.SIGINT) is before
    with pytest.raises(Interrupted):
        interruption.check()


@pytest.mark.usefixtures("heeds_ctrl_c")
def test_ignored_signals_stay_ignored() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    interruption = Interruption()
    with handling_signals(interruption.handle):
        signal.raise_signal(signal.SIGINT)
        interruption.check()
    assert signal.getsignal(signal.SIGINT) == signal.SIG_IGN


def test_run_prints_after_its_terminal_is_closed(tmp_path: Path) -> None:
    process, terminal = pty.fork()
    if process == 0:
        signal.signal(signal.SIGHUP, signal.SIG_DFL)  # also where the tests run under nohup
        interruption = Interruption()
        with handling_signals(interruption.handle):
            (tmp_path / "ready").touch()
            with suppress(Interrupted):
                while True:
                    interruption.check()
                    time.sleep(0.02)
            os.write(1, b"saved")  # an error on a closed terminal
            os._exit(3)
    while not (tmp_path / "ready").exists():
        time.sleep(0.02)
    os.close(terminal)
    assert os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]) == 3


def test_outside_the_main_thread_signals_are_left_alone() -> None:
    def enter() -> None:
        with handling_signals(Interruption().handle):
            pass

    with ThreadPoolExecutor() as pool:
        pool.submit(enter).result()


def test_processes_of_the_flows_ignore_signals_of_the_run() -> None:
    sleep = [sys.executable, "-c", "input()"]
    with ignore_signals_in_children():
        child = subprocess.Popen(sleep, stdin=subprocess.PIPE)
    for number in SIGNALS:
        child.send_signal(number)
    with pytest.raises(subprocess.TimeoutExpired):
        child.wait(0.5)
    child.communicate(b"\n")
    assert child.returncode == 0
    assert not signal.pthread_sigmask(signal.SIG_BLOCK, []) & set(SIGNALS)
