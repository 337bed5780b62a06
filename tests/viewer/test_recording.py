"""Recordings: times, values and endings of frames."""

from collections import defaultdict
from typing import Any

import pytest
import torch

from fishrl.envs import Flows, KarmanGait, Oracle, Predation, make_env, views
from fishrl.envs.scene import Ending, Frame
from fishrl.viewer import (
    Recording,
    ViewerSettings,
    make_env_scene,
    name_flows,
    record_episodes,
)
from fishrl.viewer.recording import Recorder
from tests.envs.conftest import SMALL, keep_straight, starts_at

TASK: dict[str, Any] = {**SMALL, "time_limit": 12, "food_still_T": 99.0, "checks_per_action": 20}


class Recorded:
    """Two flows of predation and their recorded frames."""

    def __init__(self, *, frames_per_T: int) -> None:
        task = Predation(**TASK)
        checks = task.checks_per_action
        self.env = make_env(
            task=task, flows=Flows(num_envs=2, compile=False), frames_per_action=checks
        )
        self.base, self.given = self.env.base_env, defaultdict[int, list[Frame]](list)
        give = lambda row, frame: self.given[row].append(frame)  # noqa: E731
        scene = make_env_scene(self.env)
        self.recorder = Recorder(self.base, scene, frames_per_T=frames_per_T, give=give)
        self.base.on_frame = lambda _: self.recorder.is_due() and self.recorder.keep([0, 1])
        self.state = self.env.reset()
        self.recorder.begin([0, 1])
        self.recorder.keep([0, 1])

    def act(self) -> None:
        step, self.state = self.env.step_and_maybe_reset(keep_straight(self.state))
        self.recorder.settle(step, [0, 1])

    def times(self, row: int) -> list[float]:
        return [frame.time for frame in self.given[row]]


def at(*times: float) -> Any:
    """Return times in T with a tolerance of two steps, of which a period has 106."""
    return pytest.approx(times, abs=0.02)


@pytest.mark.usefixtures("kinematic")
def test_frames_are_read_on_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    read, threads, before = views.read_scene, list[int](), torch.get_num_threads()

    def count(*arguments: Any, **named: Any) -> dict[str, torch.Tensor]:
        threads.append(torch.get_num_threads())
        return read(*arguments, **named)

    monkeypatch.setattr(views, "read_scene", count)
    torch.set_num_threads(2)
    try:
        Recorded(frames_per_T=2)
        assert (threads, torch.get_num_threads()) == ([1], 2)
    finally:
        torch.set_num_threads(before)


@pytest.mark.usefixtures("kinematic")
def test_frames_are_equidistant_and_hold_their_reward() -> None:
    flows = Recorded(frames_per_T=2)
    flows.recorder.keep([1])  # a repeated frame is skipped
    for _ in range(2):
        flows.act()
    assert flows.times(1) == at(0.0, 0.5, 1.0, 1.5, 2.0)
    with pytest.raises(ValueError, match="frames_per_T = 0"):
        Recorded(frames_per_T=0)
    rewards = [frame.values["reward"].item() for frame in flows.given[1]]
    assert len(set(rewards[:3])) == len(set(rewards[3:])) == 1
    assert [frame.begins for frame in flows.given[1]] == [True, False, False, False, False]


@pytest.mark.usefixtures("kinematic")
def test_frames_of_diverged_decision_are_dropped() -> None:
    for num, kept in ((1, at(0.0, 0.25, 0.5, 0.75, 1.0)), (0, [0.0])):
        flows = Recorded(frames_per_T=4)
        for _ in range(num):
            flows.act()
        flows.base.solver.body.position[1] = torch.nan
        flows.act()
        assert flows.times(0)[-1:] == at(num + 1.0)
        assert flows.times(1) == kept


def record(num_envs: int, *, device: str = "cpu") -> tuple[Predation, list[Recording], Any]:
    """Record an episode that catches the food, and one that misses it."""
    task, flows = Predation(**TASK), Flows(num_envs=num_envs, device=device, compile=False)
    starts = starts_at((5.0, 2.5), (5.0, 3.75))
    checks = task.checks_per_action
    env = make_env(task=task, flows=flows, frames_per_action=checks)
    env.rollout(1)
    scene = make_env_scene(env)
    recordings = [Recording(scene=scene), Recording(scene=scene)]

    def give(start: int, frame: Frame) -> None:
        recordings[start].frames.append(frame)

    episodes = record_episodes(env, keep_straight, starts, scene=scene, give=give, frames_per_T=10)
    env.close()
    return task, recordings, episodes


@pytest.mark.usefixtures("kinematic")
@pytest.mark.parametrize("num_envs", [1, 3])
def test_episodes_are_recorded_from_start_to_capture(num_envs: int) -> None:
    task, (caught, missed), episodes = record(num_envs)
    assert episodes.succeeded.tolist() == [True, False]
    last = caught.frames[-1].values
    assert (last["reward"], last["reward/approach"], last["reward/capture"]) == (21.0, 1.0, 20.0)
    assert caught.ending == Ending(words="caught", is_success=True)
    assert missed.ending == Ending(words="time is over", is_success=False)
    assert all(frame.ending is None for frame in caught.frames[:-1])
    # 2.25 body lengths at 0.4 per period, and at most one check
    assert caught.time[-1] == pytest.approx(2.25 / 0.4, abs=0.06)
    away = (caught.stack("food") - caught.stack("head")).norm(dim=-1)
    assert away[-1] <= task.capture_radius < away[-2]
    for recording, y in ((caught, 2.5), (missed, 3.75)):
        assert recording.stack_bl("head")[0].tolist() == pytest.approx([5.0, y])
        assert recording.time[0] == 0.0 and (recording.time.diff() > 0.0).all()
        assert torch.equal(recording.stack("fish")[:, 0], recording.stack("head"))
        assert {"action", "action_mask", "vorticity"} <= set(recording.frames[0].values)
        assert not {"pressure", "speed"} & set(recording.frames[0].values)


@pytest.mark.gpu
def test_gpu_flows_are_recorded_on_the_cpu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(TASK, "time_limit", 1)
    _, recordings, _ = record(2, device="cuda")
    for recording in recordings:
        vorticity = recording.stack("vorticity")
        assert vorticity.device.type == "cpu" and vorticity.any()


@pytest.mark.usefixtures("kinematic")
@pytest.mark.parametrize("recognition", [None, Oracle()])
def test_plots_of_missing_outputs_are_omitted(recognition: Oracle | None) -> None:
    task = KarmanGait(**{**SMALL, "wall_margin_bl": 0.25})
    env = make_env(task=task, flows=Flows(num_envs=1, compile=False), recognition=recognition)
    scene = make_env_scene(env, ViewerSettings(field="pressure", field_limit=7.0))
    names = {panel.name for panel in scene.panels}
    assert ("class probabilities" in names) == (recognition is not None)
    assert any(name.startswith("reward") for name in names)
    assert (scene.field.key, scene.field.limit) == ("pressure", 7.0)


@pytest.mark.usefixtures("kinematic")
def test_flow_titles_hold_number_and_stream() -> None:
    task = KarmanGait(**{**SMALL, "wall_margin_bl": 0.25})
    starts = task.sample_starts(3, torch.Generator().manual_seed(0))
    starts["flow_index"] = torch.tensor([2, 1, 0])
    assert name_flows(task, [0, 2], starts) == {0: "flow 0: 1.5 L/T", 2: "flow 2: 1 L/T"}
    assert name_flows(task, [4]) == {4: "flow 4"}
