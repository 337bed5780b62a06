"""Kármán gait on the real flow: small and for few actions, so the physics is not accurate."""

from math import pi

import pytest
import torch

from fishrl.envs import KarmanGait
from fishrl.envs.lateral_line import LateralLine
from fishrl.envs.stations import SafeArea
from fishrl.envs.streams import Stream
from fishrl.envs.wakes import WakeBank
from tests.envs.conftest import make_flows

#: A stream of 4 L x 2.4 L, where an eager action takes about a second.
TINY = {
    "body_length": 20,
    "reynolds": 300.0,
    "max_wall_speed": 0.15,
    "wall_margin_bl": 0.25,
    "domain_bl": (4.0, 2.4),
    "start_x_bl": (0.8, 0.9),
    "safe_area": SafeArea(near_bl=0.2, far_bl=1.5, aside_bl=0.5),
    "lateral_line": LateralLine(num_samples=4, noise=0.1, silence=0.2),
}
STREAM = {"face_bl": 1.0, "num_travels": 30.0, "num_phases": 4}


def make_task(**changes: object) -> KarmanGait:
    """Return a task whose wakes are undisturbed streams with a little noise."""
    task = KarmanGait(**TINY | changes, stream=Stream(**STREAM, diameter_bl=(0.4, 0.6, 0.5)))
    config = task.flow_config()
    generator = torch.Generator().manual_seed(0)
    noise = torch.randn(3, 4, 9, config.height, config.width, generator=generator)
    task.__dict__["wakes"] = WakeBank(
        populations=[1e-4 * noise], shedding_frequencies=torch.ones(3)
    )
    return task


@pytest.fixture(scope="module")
def task() -> KarmanGait:
    return make_task()


def test_episode_begins_behind_its_disc_and_in_its_wake(task: KarmanGait) -> None:
    starts = task.sample_starts(2, torch.Generator().manual_seed(5))
    starts["flow_index"] = torch.tensor([2, 0])
    starts["wake_phase"] = torch.tensor([0.8, 0.1]).double()
    env = make_flows(task, 2, starts=starts)
    env.reset()
    assert task.wakes is not None
    expected = task.wakes.populations[0][[2, 0], [3, 0]]
    assert torch.equal(env.solver.populations(), expected)
    discs = env.solver.markers(1)
    x, y = task.origin
    for outline, diameter in zip(discs, (10.0, 8.0), strict=True):
        assert outline[:, 0].max().item() == pytest.approx(x, abs=0.5)
        assert outline[:, 1].mean().item() == pytest.approx(y, abs=0.1)
        size = outline.amax(0) - outline.amin(0)  # its markers lie on the skin
        assert size.tolist() == pytest.approx([0.5 * diameter, diameter])
        spacing = outline.diff(dim=0).norm(dim=1)
        perimeter = diameter * (1.0 + 0.5 * pi)
        assert spacing.mean().item() == pytest.approx(perimeter / len(outline), rel=0.15)
