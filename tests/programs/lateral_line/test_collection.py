"""Collection of labelled signals: what is recorded, and what is kept."""

import importlib
import shutil
from pathlib import Path
from typing import Any

import pytest
import torch
from tensordict import TensorDict

from fishrl.envs import Flows
from fishrl.envs.changes import StreamSwitches
from fishrl.envs.lateral_line import KNOWN, LateralLine
from fishrl.envs.streams import Stream
from fishrl.programs.lateral_line import collection as collection_module
from fishrl.programs.lateral_line.collection import CollectionSettings, collect
from tests.programs.lateral_line.signals import INTERVAL, make_task


def make_settings(folder: Path, **changes: Any) -> CollectionSettings:
    given = {"max_decisions": 2, "num_samples": 5, **changes}
    given = {"flows": Flows(num_envs=2, compile=False)} | given
    return CollectionSettings(**{"task": make_task(), "data_folder": str(folder), **given})


@pytest.fixture(scope="module")
def collected(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, TensorDict]:
    folder = tmp_path_factory.mktemp("data")
    return folder, collect(make_settings(folder))


def test_collected_episodes_hold_features_and_labels(collected: tuple[Path, TensorDict]) -> None:
    _, episodes = collected
    assert episodes.shape == (4, 2)
    assert episodes["lateral_line"].shape == (4, 2, INTERVAL, 3, len(KNOWN))
    assert episodes["lateral_line"].isfinite().all()
    assert episodes["is_decision"][:, 0].all()
    assert episodes["flow_index"][:, 0].tolist() == [0, 1, 0, 1]
    speed = episodes["lateral_line"][:, 0, 0, 0, KNOWN.index("u_x")]
    assert speed[1] > 1.2 * speed[0] > 0.0


def test_changing_stream_labels_each_decision(tmp_path: Path) -> None:
    speeds = (1.0, 1.5)
    changes = StreamSwitches(speeds_bl=speeds, interval_T=0.5, ramp_T=0.25)
    stream = Stream(speeds_bl=speeds, changes=changes, has_disc=False, face_bl=1.0)
    task = make_task(stream=stream)
    episodes = collect(make_settings(tmp_path, task=task, max_decisions=4, num_samples=2))
    flow = episodes["flow_index"]
    assert flow[0].tolist() == [0, 0, 0, 1]
    assert flow[1].tolist() == [1, 1, 1, 0]


def test_actions_hold_place_or_are_random(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def collect_share(share: float) -> TensorDict:
        monkeypatch.setattr(collection_module, "RANDOM_SHARE", share)
        few = {"flows": Flows(num_envs=4, compile=False), "max_decisions": 3, "num_samples": 1}
        return collect(make_settings(tmp_path / str(share), **few))["lateral_line"]

    drawn, holding = collect_share(1.0), collect_share(0.0)
    assert torch.equal(drawn[:, 0], holding[:, 0]) and not torch.equal(drawn[:, 2], holding[:, 2])
    # swept back at once, those that hold a station beat faster, which shears the water more
    slip = KNOWN.index("slip")
    assert holding[:, 2, ..., slip].abs().mean() > drawn[:, 2, ..., slip].abs().mean()


def test_interrupted_collection_continues_exactly(
    collected: tuple[Path, TensorDict], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, episodes = collected
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    settings = make_settings(tmp_path)
    (settings.place / "piece-0001.pt").unlink()
    assert (collect(settings) == episodes).all()
    monkeypatch.setattr(collection_module, "make_env", None)
    assert (collect(settings) == episodes).all()
    (settings.place / "piece-0000.pt").write_text("cut short")
    with pytest.raises(ValueError, match=r"piece-0000.pt: cannot be read; delete the file"):
        collect(settings)


def test_data_of_own_task_are_kept_by_its_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "own_street.py").write_text(
        "from fishrl.envs import KarmanGait\n\nPULL = 1.0\n\n\nclass Own(KarmanGait):\n"
        "    def is_terminated(self, now):\n        return super().is_terminated(now) * PULL\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    own = importlib.import_module("own_street")
    settings = make_settings(tmp_path, task=own.Own())
    place = settings.place
    assert settings.place == place
    own.PULL = 2.0
    assert settings.place != place


def test_sensor_layouts_share_collected_data(tmp_path: Path) -> None:
    noisy = LateralLine(num_neuromasts=3, num_samples=INTERVAL, noise=0.1)
    shared = ({"lateral_line": noisy}, {"reads_flow_class": True})
    place = make_settings(tmp_path).place
    assert {make_settings(tmp_path, task=make_task(**given)).place for given in shared} == {place}
    for own in ({"task": make_task(speeds=(1.0, 1.4))}, {"seed": 1}, {"max_decisions": 3}):
        assert make_settings(tmp_path, **own).place != place
