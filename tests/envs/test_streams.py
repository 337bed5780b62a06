"""Streams behind discs of several sizes: labels, wakes and invalid settings."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from fishrl.envs import KarmanGait
from fishrl.envs.changes import StreamSwitches
from fishrl.envs.streams import Stream
from fishrl.envs.wakes import WakeBank, WakeRecipe
from tests.envs.conftest import SMALL, act, make_flows
from tests.envs.test_real_wake import TINY

VARIED = Stream(speeds_bl=(1.0, 1.5, 1.0), diameter_bl=(0.4, 0.4, 0.6))


def make_task(stream: Stream, **arguments: Any) -> KarmanGait:
    return KarmanGait(**SMALL | {"wall_margin_bl": 0.25, "stream": stream} | arguments)


def test_flow_names_hold_the_speed_and_a_differing_diameter() -> None:
    labels = make_task(VARIED).flow_labels
    assert [label["name"] for label in labels][1:] == ["1.5 L/T, D = 0.4 L", "1 L/T, D = 0.6 L"]
    assert [label["diameter_bl"] for label in labels] == [0.4, 0.4, 0.6]
    assert [label["name"] for label in Stream(diameter_bl=0.6).labels][:2] == ["1 L/T", "1.25 L/T"]
    assert replace(VARIED, has_disc=False).diameters_bl == (0.0, 0.0, 0.0)


def test_each_disc_has_one_file_of_wakes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recipes = []

    def develop(recipe: WakeRecipe, **_: object) -> WakeBank:
        recipes.append(recipe)
        size = recipe.config.bodies[0].size
        sizes = torch.tensor([size * speed for speed in recipe.speeds], dtype=torch.float64)
        height, width = recipe.config.height, recipe.config.width
        empty = sizes.float()[:, None, None, None, None].expand(-1, 2, 9, height, width)
        return WakeBank(populations=[empty], shedding_frequencies=sizes)

    monkeypatch.setattr("fishrl.envs.wakes.develop_wakes", develop)
    discs = {"speeds_bl": (1.0, 1.0, 1.5), "diameter_bl": (0.4, 0.6, 0.4), "face_bl": 1.0}
    stream = Stream(**discs, num_phases=2, wake_folder=str(tmp_path))
    for _ in range(2):
        task = KarmanGait(**TINY, stream=stream)
        assert task.wakes is not None
        found = task.wakes.shedding_frequencies / task.wakes.shedding_frequencies[0]
        assert found.tolist() == pytest.approx([1.0, 1.5, 1.5])
        first = task.wakes.populations[0][:, 0, 0, 0, 0]
        assert torch.equal(first, task.wakes.shedding_frequencies.float())
    assert len(recipes) == len(list(tmp_path.glob("*.pt"))) == 2
    x, _ = task.origin
    for recipe in recipes:  # the flat side stays in its place
        (disc,) = recipe.config.bodies
        assert recipe.position[0] + disc.size - disc.centre == pytest.approx(x + 0.5 * disc.size)


@pytest.mark.usefixtures("kinematic")
def test_flow_index_is_nearest_speed_behind_same_disc() -> None:
    changes = StreamSwitches(interval_T=0.45, ramp_T=0.4, speeds_bl=(1.0, 1.4))
    task = make_task(replace(VARIED, changes=changes), control_interval_T=0.5, checks_per_action=13)
    starts = task.sample_starts(2, torch.Generator().manual_seed(0))
    starts["flow_index"], starts["stream_speeds"][:, 0] = torch.tensor([0, 2]), 1.4
    env = make_flows(task, 2, starts=starts)
    env.reset()
    for _ in range(2):
        after = act(env, 1, 1)
    assert after["flow_index"].squeeze(-1).tolist() == [1, 2]
