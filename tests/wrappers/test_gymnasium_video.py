"""Pictures of flows for Gymnasium's ``RecordVideo``."""

from dataclasses import replace

import numpy as np
import pytest

from fishrl.envs import Flows, Predation, make_env
from fishrl.wrappers.gymnasium import FlowVectorEnv
from tests.envs.conftest import SMALL

pytestmark = pytest.mark.usefixtures("kinematic")
TASK = Predation(**SMALL, domain_bl=(6.0, 4.0), start_x_bl=(3.0, 4.0))


def make(**options: str) -> FlowVectorEnv:
    env = make_env(task=TASK, flows=Flows(num_envs=2, compile=False))
    return FlowVectorEnv(env, render_mode="rgb_array", **options)


def test_each_row_is_rendered() -> None:
    envs = make()
    assert envs.render_mode in envs.metadata["render_modes"]
    envs.reset(seed=0)
    before = envs.render()
    envs.step(np.array([1, 1]))
    after = envs.render()
    envs.close()
    assert len(before) == 2
    for first, second in zip(before, after, strict=True):
        assert first.dtype == np.uint8 and first.shape[2] == 3
        assert first.shape == second.shape and not np.array_equal(first, second)
    assert not np.array_equal(*before)  # they start at different places


def test_path_restarts_with_each_episode() -> None:
    pictures = []
    for seen_before in (0, 2):
        envs = make(autoreset_mode="Disabled")
        envs.reset(seed=0)
        for decision in range(2):
            envs.step(np.array([1, 1]))
            for _ in range(seen_before > decision):
                envs.render()
        envs.reset(options={"reset_mask": np.array([True, False])})
        envs.step(np.array([1, 1]))  # nobody looked at the start
        pictures.append(envs.render())
        envs.close()
    (fresh, _), (after, other) = pictures
    assert np.array_equal(after, fresh)
    assert not np.array_equal(other, pictures[0][1])  # its episode and path continue


@pytest.mark.parametrize(("mode", "end"), [("NextStep", "time is over"), ("SameStep", "")])
def test_last_picture_of_episode_shows_ending(mode: str, end: str) -> None:
    env = make_env(task=replace(TASK, time_limit=2), flows=Flows(num_envs=1, compile=False))
    envs = FlowVectorEnv(env, render_mode="rgb_array", autoreset_mode=mode)
    envs.reset(seed=0)
    words = []
    for _ in range(4):
        envs.step(np.array([1]))
        envs.render()
        (painter,) = envs._pictures.painters
        words.append(painter._flow.ending.get_text())
        (food,) = [text for text in painter._flow.axes.texts if text.get_text() == "food"]
        assert food.get_visible() is not bool(words[-1])
    envs.close()
    assert words == ["", end, "", ""]


def test_other_render_modes_are_refused() -> None:
    env = make_env(task=TASK, flows=Flows(num_envs=1, compile=False))
    with pytest.raises(ValueError, match="render_mode = 'human'"):
        FlowVectorEnv(env, render_mode="human")
    env.close()
