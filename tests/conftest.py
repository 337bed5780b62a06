"""Fixtures and hooks for all tests."""

import signal
import sys
from collections.abc import Iterator

import pytest
import torch

from fishrl.figure_style import STYLE
from fishrl.limits import count_cores
from fishrl.physics import InPlaceSolver
from fishrl.physics.fast.part import Repeater

STYLE["savefig.dpi"] = 50  # draws faster


def pytest_xdist_auto_num_workers() -> int:
    """Use one process more than there are cores, since many tests wait for other processes."""
    return count_cores() + 1


@pytest.fixture(autouse=True, scope="session")
def one_thread_in_fixtures() -> None:
    """Run torch on one thread in fixtures of modules and of the session."""
    torch.set_num_threads(1)


@pytest.fixture(autouse=True, scope="session")
def launched_one_by_one() -> Iterator[None]:
    """Record no graphs of eager steps on the pretended device; they have some 1,000 operators."""
    with pytest.MonkeyPatch.context() as patch:
        if "device" in sys.modules:
            patch.setattr(Repeater, "_replay", Repeater.launch)
        yield


@pytest.fixture(autouse=True, scope="session")
def same_draws() -> Iterator[None]:
    """Let environments that get no seed take 0, so that tests repeat."""
    with pytest.MonkeyPatch.context() as patch:
        if making := sys.modules.get("fishrl.envs.making"):  # tests of physics have none
            patch.setattr(making, "randbits", lambda _: 0)
        yield


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    """Run torch on one thread, which is fastest for small tensors."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(autouse=True)
def real_flow() -> None:
    """Check that earlier tests have restored the real flow."""
    env = sys.modules.get("fishrl.envs.flow_env")  # tests of physics import no environments
    assert env is None or env.InPlaceSolver is InPlaceSolver


@pytest.fixture
def kinematic(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replace flows by fish that move at constant speed."""
    from tests.envs.conftest import move_kinematically

    move_kinematically(monkeypatch)


@pytest.fixture
def heeds_ctrl_c() -> Iterator[None]:
    """Restore SIGINT, which is ignored if tests run in the background of a shell."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run physics and environments first, on which all others depend, and skip without CUDA."""
    if not torch.cuda.is_available():
        for item in items:
            if item.get_closest_marker("gpu"):
                item.add_marker(pytest.mark.skip(reason="there is no CUDA"))
    items.sort(key=lambda item: not item.nodeid.startswith(("tests/physics", "tests/envs")))
