"""Flows in processes of their own: what happens when one fails, and what is left behind."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from fishrl.physics import DCylinder, FlowConfig, InPlaceSolver
from fishrl.physics.bodies.motion import Fixed, Oscillating
from fishrl.physics.cases import PERIODIC
from fishrl.physics.fast import compiled as compiled_module
from fishrl.physics.fast import execution as execution_module
from fishrl.physics.fast import workers as workers_module

#: Without walls it compiles two parts, the fewest.
CONFIG = FlowConfig(width=32, height=24, tau=0.6, boundaries=PERIODIC)
ON_LINUX = pytest.mark.skipif(sys.platform != "linux", reason="it reads /proc")

#: What a user of flows does: wait for the step to be ready, then take one step after the other.
PROGRAM = """
from fishrl.physics import FlowConfig, InPlaceSolver
config = FlowConfig(width=32, height=24, tau=0.6)
solver = InPlaceSolver(config=config, num_envs=1, compile=False, num_workers=1)
print("begun", flush=True)
solver.compile()
print("ready", flush=True)
while True:
    solver.advance_(2000)
"""
#: A body that moves in a way of its own, and flows with it.
OWN_CLASS = """
from fishrl.physics.bodies.motion import Fixed
class Own(Fixed):
    pass
"""
WITH_OWN = """
from fishrl.physics import DCylinder, FlowConfig, InPlaceSolver
body = DCylinder(diameter=8, motion=Own())
config = FlowConfig(width=48, height=40, tau=0.6, bodies=(body,))
def make(**settings):
    return InPlaceSolver(config=config, num_envs=2, **settings)
"""
#: A compiler without space for a library, or for the headers compiled before it.
COMPILER = """#!/bin/sh
case "$*" in
  *-shared* | *.gch*) echo 'no space left' >&2; exit 1;;
  *) exec /usr/bin/g++ "$@";;
esac
"""


def make_solver(num_workers: int, *, compile: bool = False) -> InPlaceSolver:
    solver = InPlaceSolver(config=CONFIG, num_envs=2, compile=compile, num_workers=num_workers)
    f = torch.zeros(2, 9, 24, 32)
    f[:, 1, 10, 10] = 0.01
    solver.set_populations_(f)
    return solver


def list_processes(solver: InPlaceSolver) -> list[subprocess.Popen[bytes]]:
    assert solver._execution.workers is not None
    return list(solver._execution.workers._processes)


def assert_ended_by(
    kind: type[BaseException],
    solver: InPlaceSolver,
    processes: list[subprocess.Popen[bytes]],
    match: str = "",
) -> None:
    with pytest.raises(kind, match=match):
        solver.advance_(2)
    assert all(process.poll() is not None for process in processes)
    with pytest.raises(ChildProcessError, match="make a new solver"):
        solver.advance_(2)


def find_processes(mark: str) -> set[int]:
    """Return the processes that have a word in their environment."""
    found = set()
    for path in Path("/proc").glob("[0-9]*/environ"):
        try:
            if mark.encode() in path.read_bytes():
                found.add(int(path.parent.name))
        except OSError:  # it has ended
            pass
    return found


def start_marked(code: str, folder: Path) -> subprocess.Popen[bytes]:
    """Start a program that ``find_processes`` finds, with those that it starts."""
    env = {**os.environ, "LEFT_BY": str(folder)}
    return subprocess.Popen([sys.executable, "-c", code], env=env, stdout=subprocess.PIPE)


def await_processes(folder: Path, num: int) -> set[int]:
    """Return what is left of a program once there are no more than ``num`` processes.

    They are looked at once: one that is starting shows no environment for a moment.
    """
    deadline = time.monotonic() + 300.0
    while len(left := find_processes(str(folder))) > num and time.monotonic() < deadline:
        time.sleep(0.1)
    assert len(left) == num
    return left


def test_flows_are_checked_on_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    solver, threads, before = make_solver(0), list[int](), torch.get_num_threads()
    (grid,) = solver._batch.grids
    check = grid.check.run

    def count(*arguments: Any) -> None:
        threads.append(torch.get_num_threads())
        check(*arguments)

    monkeypatch.setattr(grid.check, "run", count)
    torch.set_num_threads(2)
    try:
        assert not solver.is_diverged().any()
        assert (threads, torch.get_num_threads()) == ([1, 1], 2)
    finally:
        torch.set_num_threads(before)


def test_workers_share_flows_and_equal_local_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    body = DCylinder(diameter=8, motion=Oscillating(sway=(1.0, 0.5)))
    flows: Any = {"config": replace(CONFIG, width=48, height=40, bodies=(body,)), "num_envs": 6}
    here, there = (
        InPlaceSolver(compile=False, num_workers=count, frequency=0.01, **flows) for count in (0, 2)
    )
    there.compile()
    send, shares = workers_module._send, list[int]()

    def count(pipe: Any, message: Any) -> None:
        shares.append(len(message[1]))
        send(pipe, message)

    monkeypatch.setattr(workers_module, "_send", count)
    generator = torch.Generator().manual_seed(0)
    for _ in range(12):
        rows = torch.rand(6, generator=generator) < 0.5
        shares.clear()
        for solver in (here, there):
            solver.advance_(2, rows)
        assert sorted(shares) == [int(rows.sum()) // 2, (int(rows.sum()) + 1) // 2]
        for name, value in here.state_dict().items():
            assert torch.equal(value, there.state_dict()[name]), name
    processes = list_processes(there)
    there.close()
    assert len(processes) == 2 and all(process.poll() is not None for process in processes)
    with pytest.raises(RuntimeError, match="this solver is closed: make a new one"):
        there.advance_(2)


@pytest.mark.compile
def test_single_flow_has_helper_to_compile(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TORCHINDUCTOR_CACHE_DIR", str(tmp_path))
    started: list[str] = []
    start_child = workers_module.start_child

    def start(code: str, **options: Any) -> subprocess.Popen[bytes]:
        started.append(code)
        return start_child(code, **options)

    monkeypatch.setattr(workers_module, "start_child", start)
    monkeypatch.setattr(execution_module, "count_cores", lambda: 2)
    compile_here, waited = compiled_module._compile, list[Any]()

    def compile_later(*given: Any) -> Any:
        """Wait for a part that the helper makes."""
        while not list(tmp_path.glob("fishrl/*/*.bin")):
            waited.append(time.sleep(0.1))
        return compile_here(*given)

    monkeypatch.setattr(compiled_module, "_compile", compile_later)
    torch.set_num_threads(2)  # one_thread sets it back
    counts, stored = [], []
    for _ in range(2):
        solver = InPlaceSolver(config=CONFIG, num_envs=1)
        solver.advance_(2)
        counts.append(len(started))
        stored.append(len(list(tmp_path.glob("fishrl/*/*.bin"))))
    assert torch.get_num_threads() == 2
    assert counts == [1, 1] and waited
    assert stored == [2, 2]  # collision and check; none for two threads


@pytest.mark.usefixtures("heeds_ctrl_c")
def test_solver_survives_an_interrupt_and_no_killed_worker(monkeypatch: pytest.MonkeyPatch) -> None:
    solver = make_solver(2)
    with monkeypatch.context() as patch:
        patch.setattr(workers_module.Workers, "wait", lambda _: signal.raise_signal(signal.SIGINT))
        with pytest.raises(KeyboardInterrupt):
            solver.compile()
    solver.advance_(2)
    assert solver.populations().any()
    processes = list_processes(solver)
    processes[1].kill()
    assert_ended_by(ChildProcessError, solver, processes, "it was killed")


@pytest.mark.usefixtures("heeds_ctrl_c")
def test_interrupt_leaves_no_worker_with_an_unread_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    solver = make_solver(1)
    solver.advance_(2)
    interrupt = lambda: signal.raise_signal(signal.SIGINT)  # noqa: E731
    monkeypatch.setattr(solver._execution.workers, "wait", interrupt)
    assert_ended_by(KeyboardInterrupt, solver, list_processes(solver))


@pytest.mark.usefixtures("heeds_ctrl_c")
def test_flow_interrupted_within_step_cannot_continue(monkeypatch: pytest.MonkeyPatch) -> None:
    solver = make_solver(0)
    part = solver._execution.batch.grids[0].parts[-1]
    monkeypatch.setattr(part, "run", lambda *tensors: signal.raise_signal(signal.SIGINT))
    with pytest.raises(KeyboardInterrupt):
        solver.advance_(2)
    with pytest.raises(RuntimeError, match="was interrupted within a step: make a new one"):
        solver.advance_(2)


def test_a_compiler_that_fails_is_an_error_with_its_message(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    compiler = tmp_path / "g++"
    compiler.write_text(COMPILER)
    compiler.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    monkeypatch.setenv("TORCHINDUCTOR_CACHE_DIR", str(tmp_path / "cache"))  # with no compiled step
    with pytest.raises(ChildProcessError, match=r"the compiler failed: no space left$"):
        make_solver(1, compile=True).compile()
    assert "Traceback" not in capfd.readouterr().err  # of the worker


@ON_LINUX
@pytest.mark.parametrize(
    ("phase", "number"), [("begun", signal.SIGTERM), ("ready", signal.SIGKILL)]
)
def test_killed_program_leaves_no_process(tmp_path: Path, phase: str, number: int) -> None:
    with start_marked(PROGRAM, tmp_path) as program:
        while program.stdout.readline().decode().strip() != phase:
            assert program.poll() is None
        assert phase == "begun" or len(find_processes(str(tmp_path))) >= 2
        program.send_signal(number)
    await_processes(tmp_path, 0)


#: A program whose forked child outlives some flows, and then the program itself.
FORKING = """
import os, time
from fishrl.physics import FlowConfig, InPlaceSolver
config = FlowConfig(width=32, height=24, tau=0.6)
def make():
    solver = InPlaceSolver(config=config, num_envs=1, compile=False, num_workers=1)
    solver.compile()
    return solver
closed, left = make(), make()
if os.fork() == 0:
    del left  # ends nothing: it belongs to the parent
    time.sleep(600.0)
closed.close()
left.advance_(2)
print("closed", flush=True)
time.sleep(600.0)
"""


@ON_LINUX
def test_a_forked_process_keeps_no_worker_alive_and_ends_none(tmp_path: Path) -> None:
    with start_marked(FORKING, tmp_path) as program:
        assert program.stdout.readline() == b"closed\n"
        program.kill()
    os.kill(await_processes(tmp_path, 1).pop(), signal.SIGKILL)


def test_workers_import_modules_next_to_the_script_alone(tmp_path: Path) -> None:
    (tmp_path / "own_motion.py").write_text(OWN_CLASS)
    script = tmp_path / "script.py"
    script.write_text(
        f"from own_motion import Own{WITH_OWN}make(compile=False, num_workers=1).advance_(2)\n"
        f"{OWN_CLASS}{WITH_OWN}assert make()._execution.num_workers == 0"
    )
    subprocess.run([sys.executable, str(script)], check=True)


def test_a_class_that_workers_cannot_import_is_refused() -> None:
    class Own(Fixed):
        pass

    bodies = (DCylinder(diameter=8, motion=Own()),)
    config = FlowConfig(width=48, height=40, tau=0.6, bodies=bodies)
    with pytest.raises(ValueError, match=r"num_workers = 1 .* a module"):
        InPlaceSolver(config=config, num_envs=1, compile=False, num_workers=1)
    InPlaceSolver(config=config, num_envs=1, compile=False).advance_(2)
