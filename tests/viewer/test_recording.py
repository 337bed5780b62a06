"""Recording flows: which moments are kept, what they carry, and when an episode ends."""

from types import SimpleNamespace
from typing import Any

import pytest
import torch
from tensordict import TensorDict

from fishrl.envs import KarmanGait, Predation, make_env
from fishrl.envs.scene import Field, Frame, Scene
from fishrl.viewer import Recording, make_scene, name_flows, record_episodes
from fishrl.viewer.recording import Recorder
from tests.envs.conftest import SMALL, keep_straight

FIELD = Field(key="head", name="head", unit="", limit=1.0)
TASK: dict[str, Any] = {**SMALL, "time_limit": 12, "food_still_T": 99.0}


class FakeTask:
    """Four checks per action and period; what is read is the age."""

    checks_per_action, interval_T = 4, 1.0
    scales = SimpleNamespace(period=8)

    def read_scene(self, solver: Any, starts: Any) -> dict[str, torch.Tensor]:
        return {"age": solver.body.age.clone()}


class FakeFlows:
    """Two rows with an age in steps, and the frames that a recorder gives of them."""

    def __init__(self, *, frames_per_T: int) -> None:
        self.age = torch.zeros(2)
        self.base: Any = SimpleNamespace(
            solver=SimpleNamespace(body=SimpleNamespace(age=self.age)), start=None
        )
        self.given: dict[int, list[Frame]] = {0: [], 1: []}
        self.recorder = Recorder(
            FakeTask(),  # type: ignore[arg-type]
            Scene(body_length=1.0, width=2, height=2, fields=(FIELD,)),
            frames_per_T=frames_per_T,
            give=lambda row, frame: self.given[row].append(frame),
        )
        self.recorder.begin([0, 1])
        self.recorder.keep(self.base, [0, 1])

    def act(self, *, diverged: bool = False) -> None:
        """Run one action of four checks; row 1 may diverge in it."""
        for _ in range(4):
            self.age += 2
            if self.recorder.is_due():
                self.recorder.keep(self.base, [0, 1])
        after = {"reward": self.age[:, None].clone(), "diverged": torch.tensor([[False], [True]])}
        after["diverged"] &= diverged
        step = TensorDict({"action": torch.tensor([0, 2]), "next": after}, [2])
        self.recorder.settle(step, [0, 1])

    def times(self, row: int) -> list[float]:
        return [frame.time for frame in self.given[row]]


def test_frames_come_at_equal_distances_with_the_reward_of_their_action() -> None:
    flows = FakeFlows(frames_per_T=2)
    flows.act()
    flows.act()
    assert flows.times(1) == [0.0, 0.5, 1.0, 1.5, 2.0]
    assert [frame.values["reward"].item() for frame in flows.given[1]] == [8, 8, 8, 16, 16]
    assert [frame.values["age"].item() for frame in flows.given[1]] == [0, 4, 8, 12, 16]
    assert [frame.begins for frame in flows.given[1]] == [True, False, False, False, False]


def test_a_flow_that_diverges_is_kept_up_to_the_decision_before_or_its_start() -> None:
    flows = FakeFlows(frames_per_T=4)
    flows.act()
    flows.act(diverged=True)
    assert flows.times(0)[-1] == 2.0
    assert flows.times(1) == [0.0, 0.25, 0.5, 0.75, 1.0]
    flows = FakeFlows(frames_per_T=4)
    flows.act(diverged=True)
    assert flows.times(1) == [0.0]


def test_rows_that_stand_still_give_no_further_frame() -> None:
    flows = FakeFlows(frames_per_T=4)
    flows.act()
    flows.recorder.keep(flows.base, [0])
    flows.act()
    assert flows.times(0) == sorted(set(flows.times(0)))


def test_less_than_a_frame_per_period_is_refused() -> None:
    with pytest.raises(ValueError, match="frames_per_T = 0"):
        FakeFlows(frames_per_T=0)


def record(num_envs: int, *, device: str = "cpu") -> tuple[Predation, list[Recording], Any]:
    """Record two episodes: one that catches its food, and one that misses it."""
    task = Predation(**TASK)
    starts = task.sample_starts(2, torch.Generator().manual_seed(0))
    starts["head"] = torch.tensor([[5.0, 2.5], [5.0, 3.75]], dtype=torch.float64) * 20
    env = make_env(
        task=task,
        num_envs=num_envs,
        device=device,
        compile=False,
        frames_per_action=task.checks_per_action,
    )
    env.rollout(1)  # whatever it did before
    scene = make_scene(env)
    recordings = [Recording(scene=scene), Recording(scene=scene)]

    def give(start: int, frame: Frame) -> None:
        recordings[start].frames.append(frame)

    episodes = record_episodes(env, keep_straight, starts, scene=scene, give=give, frames_per_T=10)
    env.close()
    return task, recordings, episodes


@pytest.mark.usefixtures("kinematic")
@pytest.mark.parametrize("num_envs", [1, 3])
def test_episodes_are_recorded_from_their_starts_to_the_capture(num_envs: int) -> None:
    task, (caught, missed), episodes = record(num_envs)
    assert episodes.succeeded.tolist() == [True, False]
    assert caught.frames[-1].values["reward"] == 21.0
    # 2.25 body lengths at 0.4 per period; one check more at the most
    assert caught.time[-1] == pytest.approx(2.25 / 0.4, abs=0.06)
    away = (caught.stack("food") - caught.stack("head")).norm(dim=-1)
    assert away[-1] <= task.capture_radius < away[-2]
    for recording, y in ((caught, 2.5), (missed, 3.75)):
        assert recording.stack_bl("head")[0].tolist() == pytest.approx([5.0, y])
        assert recording.time[0] == 0.0 and (recording.time.diff() > 0.0).all()
        assert torch.equal(recording.stack("fish")[:, 0], recording.stack("head"))
        assert {"action", "action_mask", "vorticity"} <= set(recording.frames[0].values)
        assert not {"pressure", "speed"} & set(recording.frames[0].values)  # not shown


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no CUDA")
def test_flows_on_a_gpu_are_recorded_on_the_cpu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(TASK, "time_limit", 1)
    _, recordings, _ = record(2, device="cuda")
    for recording in recordings:
        vorticity = recording.stack("vorticity")
        assert vorticity.device.type == "cpu" and vorticity.any()


@pytest.mark.usefixtures("kinematic")
@pytest.mark.parametrize("recognition", [None, "oracle"])
def test_plots_of_outputs_that_the_env_does_not_have_are_left_out(recognition: str | None) -> None:
    task = KarmanGait(**{**SMALL, "wall_margin_bl": 0.25})
    env = make_env(task=task, num_envs=1, compile=False, recognition=recognition)
    scene = make_scene(env, field="pressure", field_limit=7.0)
    names = {panel.name for panel in scene.panels}
    assert ("class probabilities" in names) == (recognition is not None)
    assert any(name.startswith("reward") for name in names)
    assert (scene.field.key, scene.field.limit) == ("pressure", 7.0)


@pytest.mark.usefixtures("kinematic")
def test_flows_are_titled_by_number_and_stream() -> None:
    task = KarmanGait(**{**SMALL, "wall_margin_bl": 0.25})
    starts = task.sample_starts(3, torch.Generator().manual_seed(0))
    starts["flow_index"] = torch.tensor([2, 1, 0])
    assert name_flows(task, [0, 2], starts) == {0: "flow 0: 1.5 L/T", 2: "flow 2: 1 L/T"}
    assert name_flows(task, [4]) == {4: "flow 4"}
