"""What is drawn of each task, and that all of it can be read."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import Any, ClassVar

import pytest
import torch

from fishrl.envs import AbstractTask, FlowEnv, Follower, KarmanGait, Predation
from fishrl.envs.control import DirectFrequencies
from fishrl.envs.lateral_line import LateralLine
from fishrl.envs.scene import Choice, Scene
from fishrl.envs.streams import Stream
from fishrl.envs.views import FIELDS, make_scene, read_scene
from fishrl.physics import Boundaries, Fish, FlowConfig, NonEquilibrium, OpenEdge
from fishrl.physics.flow import make_uniform
from tests.envs.conftest import CONTINUOUS, SMALL, make_flows
from tests.envs.small_tasks import MaskedTask, PairTask
from tests.envs.test_follower import TINY

pytestmark = pytest.mark.usefixtures("kinematic")

GAIT: dict[str, Any] = {**SMALL, "wall_margin_bl": 0.25}


class OwnFish(Fish):
    """A fish of another type."""


class OwnPair(PairTask):
    """Two fish of that type."""

    @cached_property
    def fish(self) -> Fish:
        return OwnFish(body_length=self.body_length)


LINE = LateralLine(is_averaged=True, features=("shear",))
DIRECT = DirectFrequencies(frequencies=(0.5, 2.0))
TASKS: dict[str, Callable[[], AbstractTask]] = {
    "predation": lambda: Predation(**SMALL),
    "gait": lambda: KarmanGait(**GAIT),
    "averaged": lambda: KarmanGait(**GAIT, lateral_line=LINE),
    "free": lambda: KarmanGait(**GAIT, stream=Stream(has_disc=False), control=DIRECT),
    "continuous": lambda: Predation(**SMALL, control=CONTINUOUS),
    "own": lambda: MaskedTask(**SMALL),
    "own fish": lambda: OwnPair(**SMALL),
}


def begin(task: AbstractTask, num_envs: int = 1) -> FlowEnv:
    env = make_flows(task, num_envs)
    env.reset()
    return env


def read(env: FlowEnv) -> dict[str, torch.Tensor]:
    return read_scene(env.task, env.solver, env.start)


def list_keys(scene: Scene) -> set[str]:
    """Return every key that is read by ``read_scene``."""
    drawn = (*scene.fields, *scene.curves, *scene.marks, *scene.trails, *scene.arrows)
    keys = {one.key for one in drawn}
    keys |= {arrow.at for arrow in scene.arrows if isinstance(arrow.at, str)}
    keys |= {marks.value for marks in scene.marks if marks.value}
    for panel in scene.panels:
        if not isinstance(panel, Choice) and not panel.is_output:
            keys |= {series.key for series in panel.series}
    return keys


@pytest.mark.parametrize("kind", TASKS)
def test_every_key_of_a_scene_can_be_read(kind: str) -> None:
    env = begin(task := TASKS[kind](), 2)
    height, width = env.solver.config.height, env.solver.config.width
    y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    still = torch.zeros(2, height, width)
    swirl = make_uniform(still, still - 1e-4 * y, still + 1e-4 * x)  # turns like a wheel
    env.solver.set_populations_(swirl)
    scene, values = make_scene(task), read(env)
    assert list_keys(scene) <= set(values)
    outlines = [curve.name for curve in scene.curves if curve.is_closed]
    assert all(outlines) and len(set(outlines)) == len(outlines)
    assert tuple(field.key for field in scene.fields) == FIELDS
    assert all(len(value) == 2 for value in values.values())
    assert values["vorticity"].shape == (2, scene.height, scene.width)
    assert values["vorticity"].float().mean() == pytest.approx(2e-4 * task.scales.period, rel=1e-3)
    assert values["pressure"].abs().max() < 1e-3
    corner = 1e-4 * math.hypot(scene.width - 1, scene.height - 1) / task.scales.reference_speed
    assert values["speed"].max().item() == pytest.approx(corner, rel=1e-3)


def test_field_of_some_flows_is_that_of_all() -> None:
    env = begin(Predation(**SMALL), 3)
    noise = torch.randn(env.solver.populations().shape, generator=torch.Generator().manual_seed(0))
    env.solver.set_populations_(0.01 * noise)
    whole, rows = read(env), torch.tensor([True, False, True])
    for key in FIELDS:
        some = read_scene(env.task, env.solver, env.start, fields=[key], rows=rows)
        assert torch.equal(some[key][rows], whole[key][rows])
        assert not some[key][~rows].any()
        assert set(whole) - set(some) == set(FIELDS) - {key}
    u = env.solver.macroscopic()[1] / env.task.scales.reference_speed
    torch.testing.assert_close(whole["speed"], u.norm(dim=1).half())


class AcrossStream(Predation):
    """Food in a stream along +y, set by the boundaries alone."""

    max_stream_speed_bl: ClassVar[float] = 0.5

    def flow_config(self) -> FlowConfig:
        stream = NonEquilibrium(velocity=(0.0, 1.0))
        edges = Boundaries(
            left=stream, right=stream, bottom=stream, top=OpenEdge(velocity=(0.0, 1.0))
        )
        speed = 0.5 * self.scales.reference_speed
        return replace(super().flow_config(), boundaries=edges, stream_speed=speed)


def test_angle_of_attack_follows_the_stream_of_each_row() -> None:
    env = begin(AcrossStream(**SMALL), 2)
    env.solver.body.heading.fill_(0.2 - 0.5 * math.pi)
    env.solver.set_stream_speed_(torch.zeros(2), torch.tensor([False, True]))
    assert read(env)["angle_of_attack"].isnan().tolist() == [False, True]
    env.solver.body.velocity[:, 0] = -0.5 * env.task.scales.reference_speed
    # without a stream the fish heads across its way
    expected = [math.degrees(0.2), math.degrees(0.2 + 0.5 * math.pi)]
    assert read(env)["angle_of_attack"].tolist() == pytest.approx(expected)


def test_angle_of_attack_of_bending_fish_is_its_heading() -> None:
    env = begin(Follower(**TINY))
    env.solver.body.internal_angle.fill_(0.05)
    torch.testing.assert_close(read(env)["angle_of_attack"], env.measure()["heading"].rad2deg())


def test_lateral_line_is_shown_only_if_felt() -> None:
    for senses, shows in ((("place", "own_motion"), False), (("own_motion", "lateral_line"), True)):
        scene = make_scene(KarmanGait(**GAIT, observes=senses))
        assert [mark.key for mark in scene.marks] == ["neuromasts"] * shows
        assert [area.key for area in scene.areas] != []
