"""Recordings: what is kept of an episode, when it ends, and what is refused."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor

import fishrl.envs.task
from experiments.recording import Recording, record_episodes
from fishrl.envs import Predation, make_env
from fishrl.viewer import Frame
from tests.envs.gliding import GlidingSolver

Maker = Callable[..., Recording]
TASK: dict[str, Any] = {
    "body_length": 20, "reynolds": 500.0, "max_wall_speed": 0.15, "wall_margin_bl": 0.15,
    "time_limit": 12, "food_still_T": 99.0,
}  # fmt: skip


def test_episodes_are_recorded_from_their_starts_to_the_capture(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(fishrl.envs.task, "InPlaceSolver", GlidingSolver)
    task = Predation(**TASK)
    starts = task.sample_starts(2, torch.Generator().manual_seed(0))
    starts["head"] = torch.tensor([[5.0, 2.5], [5.0, 3.75]], dtype=torch.float64) * 20

    def keep_straight(td: TensorDict) -> TensorDict:
        return td.set("action", torch.ones(3, dtype=torch.int64))

    ended: list[int] = []
    given: list[tuple[int, Frame]] = []
    env = make_env(task=task, num_envs=3, frames_per_action=task.checks_per_action)
    env.rollout(1)  # whatever it did before
    caught, missed = record_episodes(
        env=env,
        policy=keep_straight,
        starts=starts,
        on_episodes=ended.append,
        give=lambda start, frame: given.append((start, frame)),
    )
    assert ended == [1, 1]
    times = [[frame.time for start, frame in given if start == own] for own in (0, 1)]
    assert times == [caught.time.tolist(), missed.time.tolist()]
    assert (caught.captured, missed.captured) == (True, False)
    assert caught.reward[-1] == 21.0
    # 2.25 body lengths at 0.4 per period; one look more at the most
    assert caught.time[-1] == pytest.approx(2.25 / 0.4, abs=0.06)
    assert (caught.food - caught.head)[-1].norm() <= caught.capture_radius
    for recording, start in zip((caught, missed), starts, strict=True):
        assert recording.head[0].tolist() == pytest.approx(start["head"].tolist())
        assert torch.equal(recording.outline[:, 0], recording.head)
        per_period = recording.vorticity.float().mean()
        assert per_period == pytest.approx(0.02 * task.scales.period, rel=1e-3)


@pytest.mark.gpu
@pytest.mark.compile
@pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no CUDA")
def test_flows_on_a_gpu_are_recorded_from_starts_that_are_not_there() -> None:
    task = Predation(**{**TASK, "time_limit": 1})
    starts = task.sample_starts(2, torch.Generator().manual_seed(0))
    env = make_env(task=task, num_envs=2, device="cuda", frames_per_action=task.checks_per_action)

    def keep_straight(td: TensorDict) -> TensorDict:
        return td.set("action", torch.ones(2, dtype=torch.int64, device=td.device))

    recordings = record_episodes(env=env, policy=keep_straight, starts=starts)
    env.close()
    for recording, start in zip(recordings, starts, strict=True):
        assert recording.head[0].tolist() == pytest.approx(start["head"].tolist())
        assert recording.vorticity.device.type == "cpu" and recording.vorticity.any()


@pytest.mark.parametrize(
    ("num_starts", "frames_per_T", "message"),
    [
        (2, 0, "frames_per_T = 0: at least one"),
        (3, 10, "3 starts, but the env has 2 flows: give no more"),
    ],
)
def test_no_frames_and_more_starts_than_flows_are_refused(
    monkeypatch: pytest.MonkeyPatch, num_starts: int, frames_per_T: int, message: str
) -> None:
    monkeypatch.setattr(fishrl.envs.task, "InPlaceSolver", GlidingSolver)
    task = Predation(**TASK)
    starts = task.sample_starts(num_starts, torch.Generator().manual_seed(0))
    with pytest.raises(ValueError, match=message):
        record_episodes(
            env=make_env(task=task, num_envs=2), policy=lambda td: td, starts=starts,
            frames_per_T=frames_per_T,
        )  # fmt: skip


def test_a_recording_survives_its_file(make_recording: Maker, tmp_path: Path) -> None:
    recording = make_recording(num_frames=3)
    recording.save(tmp_path / "episode.pt")
    loaded = Recording.load(tmp_path / "episode.pt")
    for field in dataclasses.fields(Recording):
        old, new = getattr(recording, field.name), getattr(loaded, field.name)
        assert torch.equal(old, new) if isinstance(old, Tensor) else old == new


def test_a_file_that_is_no_recording_is_refused(tmp_path: Path) -> None:
    torch.save({"weights": 1}, tmp_path / "x.pt")
    with pytest.raises(ValueError, match=r"is no recording: it holds \['weights'\]"):
        Recording.load(tmp_path / "x.pt")
    with pytest.raises(FileNotFoundError, match="no recording at"):
        Recording.load(tmp_path / "nothing.pt")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"body_length": 0.0}, "body_length = 0.0, period = 200: both must be positive"),
        ({"time": torch.zeros(0)}, "no frame"),
        ({"head": torch.zeros(4, 2)}, r"head has shape \(4, 2\), expected \(3, 2\)"),
        ({"outline": torch.zeros(3, 2)}, "outline has shape"),
        ({"domain": (10, 10)}, r"vorticity has shape .*expected \(3, 10, 10\)"),
        ({"reward": torch.full((3,), torch.nan)}, "reward is not finite"),
        ({"time": torch.tensor([0.0, 1.0, 1.0])}, "time does not increase"),
    ],
)
def test_what_cannot_be_drawn_is_refused(
    make_recording: Maker, changes: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(make_recording(num_frames=3), **changes)
