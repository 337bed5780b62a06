"""What the viewer shows of fish in real flows: every view of a recording draws."""

from __future__ import annotations

from pathlib import Path

import pytest

from experiments.view import ViewConfig, record
from fishrl.envs import AbstractTask, make_env
from fishrl.training.description import make
from fishrl.viewer import make_scene, photograph_views
from tests.envs.test_real_flow import TINY
from tests.experiments.real_wake import gait_settings
from tests.viewer.pictures import check_views, needs_vulkan

HUNT = {"_target_": "fishrl.envs.Predation", **TINY}


@needs_vulkan
@pytest.mark.parametrize("policy", ["intercept", "pid"])
def test_every_view_of_a_fish_in_a_real_flow_draws(
    tmp_path: Path, real_wake: Path, policy: str
) -> None:
    path = tmp_path / "fish.rrd"
    if policy == "intercept":  # half a picture of nothing; compression would mix its few nodes
        task, recognition = HUNT, None
        looks = {"periods": 2.0, "field_limit": 6.0, "field_format": "u8"}
        least = 0.001
    else:
        task, recognition = gait_settings(real_wake), "oracle"
        looks = {"periods": 0.6, "field_limit": 30.0, "frames_per_T": 30}
        least = 0.005
    config = ViewConfig(
        task=task,
        preset="tiny",
        policy=policy,
        recognition=recognition,
        compile=False,
        **looks,  # type: ignore[arg-type]
    )
    record(config, save=path)
    env = make_env(
        task=make(task, kind=AbstractTask), num_envs=1, compile=False, recognition=recognition
    )
    scene = make_scene(env)
    env.close()
    pictures = photograph_views(path, time_T=0.9 * float(config.periods or 0.0))
    (title,) = [one.name for one in pictures if one.origin == "/flow_0/world"]
    check_views(pictures, scene, title=title, least=least)
