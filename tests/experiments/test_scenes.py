"""What there is to see follows from what a task has, and all of it can be read off the env."""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch

from experiments.scenes import TaskView, name_actions
from fishrl.envs import KarmanGait, Predation, make_env
from fishrl.envs.lateral_line import LateralLine
from fishrl.envs.macro_actions import DirectFrequencies
from fishrl.envs.streams import Stream
from fishrl.training.recognition import Recognition
from fishrl.viewer import Choice
from tests.envs.conftest import SMALL, gliding  # noqa: F401 - a fixture
from tests.envs.shy_task import Shy

pytestmark = pytest.mark.usefixtures("gliding")

GAIT: dict[str, Any] = {**SMALL, "wall_margin_bl": 0.25}
#: Entries of the step rather than of the flow; and the disc, which gliding fish do not have.
ELSEWHERE = {"reward", "action", "action_mask", "flow_probabilities", "dcylinder_1"}


def make_task(kind: str) -> Any:
    return {
        "predation": lambda: Predation(**SMALL),
        "gait": lambda: KarmanGait(**GAIT),
        "averaged": lambda: KarmanGait(
            **GAIT, lateral_line=LateralLine(is_averaged=True, features=("shear",))
        ),
        "free": lambda: KarmanGait(
            **GAIT,
            stream=Stream(has_disc=False),
            control=DirectFrequencies(frequencies=(0.5, 2.0)),
        ),
        "own": lambda: Shy(**SMALL),
    }[kind]()


def find_keys(view: TaskView) -> set[str]:
    """Return every key that a scene names."""
    scene = view.scene
    keys = {scene.field.key, *(one.key for one in (*scene.outlines, *scene.marks, *scene.trails))}
    keys |= {marks.value for marks in scene.marks if marks.value}
    for panel in scene.panels:
        if isinstance(panel, Choice):
            keys |= {panel.key, panel.mask}
        else:
            keys |= {series.key for series in panel.series}
    return keys


def test_what_a_sign_means_is_said_without_colours_which_the_format_chooses() -> None:
    note = TaskView(make_task("predation")).scene.field.note
    assert note == "positive turns counter-clockwise"


@pytest.mark.parametrize("kind", ["predation", "gait", "averaged", "free", "own"])
def test_everything_that_a_scene_names_can_be_read(kind: str) -> None:
    task = make_task(kind)
    recognition = Recognition(task, "oracle" if kind in ("gait", "averaged") else None)
    env = recognition.equip(make_env)(task=recognition.task, num_envs=2, compile=False)
    view = TaskView(recognition.task, is_told=recognition.num_told > 0)
    values = view.read(env.base_env)
    assert find_keys(view) <= set(values) | ELSEWHERE
    assert all(len(value) == 2 for value in values.values())
    assert values["vorticity"].shape == (2, view.scene.height, view.scene.width)
    assert values["vorticity"].float().mean() == pytest.approx(0.02 * task.scales.period, rel=1e-3)
    step = env.rand_step(env.reset())
    assert find_keys(view) & (ELSEWHERE - {"dcylinder_1"}) <= set(step.keys()) | {"reward"}


@pytest.mark.parametrize(
    ("kind", "names", "areas"),
    [
        ("predation", {"distance of the food [L]"}, {"edges"}),
        (
            "gait",
            {"class probabilities", "pressure felt [ρ (L/T)²]", "nose from the flat side [L]"},
            {"edges", "danger_area"},
        ),
        ("own", set(), {"edges"}),
    ],
)
def test_each_task_gets_the_plots_that_belong_to_it(
    kind: str, names: set[str], areas: set[str]
) -> None:
    view = TaskView(make_task(kind), is_told=kind == "gait")
    always = {"reward", "action (line) among the legal ones (dots)", "tail-beat frequency [1/T]"}
    always |= {"angle of attack [°]", "power [ρ L⁴/T³]"}
    assert {panel.name for panel in view.scene.panels} == always | names
    assert {area.key for area in view.scene.areas} == areas


def test_the_danger_area_of_the_scene_is_that_of_the_task() -> None:
    task = make_task("gait")
    (area,) = [area for area in TaskView(task).scene.areas if area.key == "danger_area"]
    for x, y in (area.low, area.high, (area.low[0], area.high[1])):
        place = (torch.tensor([[x, y]], dtype=torch.float64) - task.origin) / task.body_length
        assert task.safe_area.measure_margin(place).item() == pytest.approx(0.0, abs=1e-9)


def test_the_midline_of_a_straight_fish_is_its_axis() -> None:
    env = make_env(task=make_task("predation"), num_envs=1, compile=False)
    midline = TaskView(env.base_env.task).read(env.base_env)["midline"][0]
    head = env.base_env.solver.head()[0]
    assert midline[:, 1].tolist() == pytest.approx([head[1].item()] * len(midline))
    assert midline[0].tolist() == pytest.approx(head.tolist())
    assert midline[-1, 0] - head[0] == pytest.approx(20.0)


@pytest.mark.parametrize("turn", [0.1, -0.3])
def test_the_angle_of_attack_is_from_upstream_or_from_where_the_fish_swims(turn: float) -> None:
    for kind in ("gait", "predation"):
        env = make_env(task=make_task(kind), num_envs=1, compile=False)
        base, view = env.base_env, TaskView(env.base_env.task)
        base.solver.body.heading.fill_(math.pi + turn)
        if kind == "predation":
            assert view.read(base)["angle_of_attack"].isnan().all()  # it does not swim yet
            base.solver.body.velocity[:, 0] = -0.5 * base.task.scales.reference_speed
        angle = view.read(base)["angle_of_attack"].item()
        assert angle == pytest.approx(math.degrees(turn)), kind


def test_flows_are_called_after_their_streams() -> None:
    task = make_task("gait")
    starts = task.sample_starts(3, torch.Generator().manual_seed(0))
    starts["flow_index"] = torch.tensor([2, 1, 0])
    titles = TaskView(task).name_flows(starts, [0, 2])
    assert titles == {0: "flow 0: 1.5 L/T", 2: "flow 2: 1 L/T"}
    assert TaskView(make_task("predation")).name_flows({}, [4]) == {4: "flow 4"}


@pytest.mark.parametrize(
    ("kind", "names"),
    [
        ("gait", ("decelerate", "cruise", "accelerate")),
        ("free", ("0.5 beats/T", "2 beats/T")),
        ("predation", ("turn -15°", "keep", "turn +15°")),
    ],
)
def test_actions_are_called_by_what_they_do(kind: str, names: tuple[str, ...]) -> None:
    assert name_actions(make_task(kind)) == names
