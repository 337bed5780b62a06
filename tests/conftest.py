"""Things that tests of several packages share."""

import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from math import pi
from pathlib import Path

import pytest
import torch

import fishrl.envs.task
from fishrl.envs import Predation
from fishrl.envs.scene import Frame
from fishrl.physics import InPlaceSolver
from fishrl.physics.fast.step import Stepper
from fishrl.viewer import Recording
from tests.experiments.real_wake import develop


def _make_recording(
    *, num_frames: int = 17, has_succeeded: bool = True, lane: float = 1.5
) -> Recording:
    """Return vortices of alternating sign, shed by a beating outline that heads for its food."""
    task, length = Predation(body_length=20, reynolds=500.0, wall_margin_bl=0.25), 20.0
    time = torch.arange(num_frames) / 4
    nose = torch.stack((7.5 - 0.8 * time, lane + 0.2 * (0.7 * time).sin()), 1) * length
    s = torch.linspace(0, 2 * pi, 41)[:-1]
    body_x = 0.5 * (1 - s.cos())
    wave = 0.1 * body_x * (2 * pi * (body_x - time[:, None])).sin()
    body_y = wave + 0.06 * s.sin()
    outline = nose[:, None] + length * torch.stack((body_x.expand_as(body_y), body_y), -1)
    rows, columns = torch.meshgrid(torch.arange(100), torch.arange(200), indexing="ij")
    vorticity = torch.zeros(num_frames, 100, 200)
    for i, age in enumerate(time.tolist()):
        for k in range(int(2 * age) + 1):
            x_k, y_k = (9.0 - 0.4 * k) * length, (lane + 0.15 * (-1) ** k) * length
            r2 = (columns - x_k) ** 2 + (rows - y_k) ** 2
            core = (0.15 * length) ** 2 * (1 + 0.3 * max(age - k / 2, 0.0))
            vorticity[i] += 12.0 * (-1) ** k * torch.exp(-r2 / core)
    values = {
        "vorticity": vorticity.half(),
        "fish": outline,
        "midline": outline,
        "head": nose,
        "food": torch.tensor([2.5, lane]).mul(length).expand(num_frames, 2),
    }
    frames = [
        Frame(time=float(time[i]), values={name: value[i] for name, value in values.items()})
        for i in range(num_frames)
    ]
    return Recording(scene=task.make_scene(), frames=frames, has_succeeded=has_succeeded)


@pytest.fixture
def make_recording() -> Callable[..., Recording]:
    """Return the maker of synthetic recordings."""
    return _make_recording


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
    """Begin each test with the real flow, whatever an earlier one has left behind."""
    assert fishrl.envs.task.InPlaceSolver is InPlaceSolver


@pytest.fixture(scope="session")
def real_wake(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the developed wake of ``real_wake.gait_settings``."""
    folder = tmp_path_factory.mktemp("wakes")
    develop(folder)
    return folder


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
