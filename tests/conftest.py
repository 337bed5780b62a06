"""Things that tests of several packages share."""

import os
import signal
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

from fishrl.physics import InPlaceSolver
from fishrl.physics.fast.stepper import Stepper


@pytest.fixture(autouse=True, scope="session")
def one_thread_in_fixtures() -> None:
    """Run torch on one thread in fixtures of modules and of the session too."""
    torch.set_num_threads(1)


@pytest.fixture(autouse=True, scope="session")
def launched_one_by_one() -> Iterator[None]:
    """Record no eager steps as graphs of the pretended device: they have some 1,000 operators."""
    with pytest.MonkeyPatch.context() as patch:
        if "device" in sys.modules:
            patch.setattr(Stepper, "_replay_", Stepper._advance_pairs_)
        yield


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    """Run torch on one thread: what tests compute is too small to share."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(autouse=True)
def real_flow() -> None:
    """Begin each test with the real flow, regardless of what an earlier one left behind."""
    env = sys.modules.get("fishrl.envs.flow_env")  # tests of physics import no environments
    assert env is None or env.InPlaceSolver is InPlaceSolver


@pytest.fixture
def kinematic(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let fish move without a flow."""
    from tests.envs.conftest import move_kinematically

    move_kinematically(monkeypatch)


@pytest.fixture
def heeds_ctrl_c() -> Iterator[None]:
    """Undo that SIGINT is ignored, as where the tests run in the background of a shell."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture
def read_only_folder() -> Iterator[Path]:
    """A folder that its user may not write; root, who may write anywhere, becomes nobody."""
    folder = Path(tempfile.mkdtemp())
    is_root, nobody = os.geteuid() == 0, 65534
    if is_root:
        os.chown(folder, nobody, nobody)
    folder.chmod(0o500)
    if is_root:
        os.seteuid(nobody)
    yield folder
    if is_root:
        os.seteuid(0)
    folder.rmdir()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run physics and environments first: what fails there fails everywhere."""
    items.sort(key=lambda item: not item.nodeid.startswith(("tests/physics", "tests/envs")))
