"""Systems without POSIX: only functions that need it raise errors."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
#: Run without the names that Windows lacks.
PROGRAM = """
import importlib, os, pathlib, pkgutil, select, signal, sys
import psutil, torchrl.data  # whose builds for Linux need some
sys.modules["fcntl"] = None
for name in ("fork", "killpg", "memfd_create", "sched_getaffinity", "sysconf"):
    vars(os).pop(name, None)
for name in ("pthread_sigmask", "SIG_BLOCK", "SIG_SETMASK", "SIGHUP", "SIGKILL", "SIGUSR1"):
    vars(signal).pop(name, None)
del select.poll

import experiments, fishrl
for package in (fishrl, experiments):
    for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)

from experiments.reproduce import alone
from fishrl.children import start_child
from fishrl.physics import Cylinder, FlowConfig, InPlaceSolver
from fishrl.memory import check_memory
from fishrl.training.interruption import ignore_signals_in_children
from fishrl.training.run_folder import RunFolder

here = pathlib.Path(sys.argv[1])
with RunFolder(here).hold(), alone(here), ignore_signals_in_children():
    check_memory(flows=1e9)
    config = FlowConfig(width=64, height=64, tau=0.8, bodies=(Cylinder(diameter=10),))
    InPlaceSolver(config=config, num_envs=2, compile=False).advance_(2)
for call in (lambda: start_child(""), lambda: InPlaceSolver(config=config, num_workers=1)):
    try:
        call()
    except ValueError as error:
        print(error)
"""


def test_child_processes_need_posix(tmp_path: Path) -> None:
    words = [sys.executable, "-c", PROGRAM, str(tmp_path)]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    refused = done.stdout.splitlines()
    assert len(refused) == 2 and all("need Linux or macOS" in line for line in refused)
