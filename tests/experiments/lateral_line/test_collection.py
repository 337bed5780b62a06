"""Collection of labelled signals: what is recorded, and what is kept."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
import torch
from tensordict import TensorDict

from experiments.lateral_line import collection as collection_module
from experiments.lateral_line.collection import Collection, collect
from fishrl.envs import Predation, make_env, make_recognition
from fishrl.envs.lateral_line import KNOWN, LateralLine
from fishrl.modules import LateralLineClassifier
from tests.experiments.lateral_line.signals import INTERVAL, make_task


@pytest.fixture(scope="module")
def collected(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, TensorDict]:
    folder = tmp_path_factory.mktemp("data")
    collection = Collection(task=make_task(), num_envs=2, max_decisions=2)
    return folder, collect(collection, num_samples=5, folder=folder, compile=False)


def test_collected_episodes_hold_every_feature_with_the_true_flow(
    collected: tuple[Path, TensorDict],
) -> None:
    _, episodes = collected
    assert episodes.shape == (4, 2)
    assert episodes["lateral_line"].shape == (4, 2, INTERVAL, 3, len(KNOWN))
    assert episodes["lateral_line"].isfinite().all()
    assert episodes["is_decision"][:, 0].all()
    assert episodes["flow_index"][:, 0].tolist() == [0, 1, 0, 1]
    speed = episodes["lateral_line"][:, 0, 0, 0, KNOWN.index("u_x")]
    assert speed[1] > 1.2 * speed[0] > 0.0


def test_actions_hold_stations_or_are_random_in_rows_of_any_flow(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def collect_share(share: float) -> TensorDict:
        monkeypatch.setattr(collection_module, "RANDOM_SHARE", share)
        collection = Collection(task=make_task(), num_envs=4, max_decisions=3)
        return collect(collection, num_samples=1, folder=tmp_path / str(share), compile=False)

    drawn, holding = collect_share(1.0), collect_share(0.0)
    assert (drawn["named_flow"] == holding["named_flow"]).all()
    assert (drawn["named_flow"] != drawn["flow_index"]).any()
    # swept back at once, all accelerate but those whose station is nearly out of reach
    assert holding["frequency"][:, 2].mean() > drawn["frequency"][:, 2].mean()
    rows = torch.tensor(((0.5, 1.0, 1.5), (1.0, 1.25, 1.5)))
    for episodes in (drawn, holding):
        row = rows[episodes["named_flow"][:, 1:]]
        assert (row == episodes["frequency"][:, 1:, None]).any(-1).all()


def test_collected_pieces_are_not_run_again(
    collected: tuple[Path, TensorDict], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, episodes = collected
    monkeypatch.setattr(collection_module, "make_env", None)
    collection = Collection(task=make_task(), num_envs=2, max_decisions=2)
    assert (collect(collection, num_samples=5, folder=folder) == episodes).all()


def test_an_interrupted_collection_continues_exactly(
    collected: tuple[Path, TensorDict], tmp_path: Path
) -> None:
    folder, episodes = collected
    collection = Collection(task=make_task(), num_envs=2, max_decisions=2)
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    (tmp_path / collection.key / "piece-0001.pt").unlink()
    resumed = collect(collection, num_samples=5, folder=tmp_path, compile=False)
    assert (resumed == episodes).all()


def test_other_sensors_share_the_data_and_other_flows_and_seeds_do_not() -> None:
    key = Collection(task=make_task()).key
    noisy = make_task(lateral_line=LateralLine(num_neuromasts=3, num_samples=INTERVAL, noise=0.1))
    assert Collection(task=noisy).key == key
    assert Collection(task=make_task(reads_flow_class=True)).key == key
    assert Collection(task=make_task(speeds=(1.0, 1.4))).key != key
    assert Collection(task=make_task(), seed=1).key != key
    assert Collection(task=make_task(), max_decisions=3).key != key


def test_a_broken_piece_is_named(tmp_path: Path) -> None:
    collection = Collection(task=make_task())
    place = tmp_path / collection.key
    place.mkdir()
    (place / "piece-0000.pt").write_text("cut short")
    with pytest.raises(ValueError, match=r"piece-0000.pt: cannot be read; delete the file"):
        collect(collection, num_samples=1, folder=tmp_path)


def test_a_task_without_two_flows_is_refused() -> None:
    with pytest.raises(ValueError, match="Predation has no two flows to tell apart"):
        Collection(task=Predation())


def test_a_classifier_labels_a_real_flow_for_the_policy() -> None:
    task = make_task(reads_flow_class=True)
    classifier = LateralLineClassifier(flows=task.flow_labels, sensors=task.lateral_line_layout)
    transforms = make_recognition(classifier, memory=0.0)
    env = make_env(task=task, num_envs=2, compile=False, transforms=transforms)
    rollout = env.rollout(1, break_when_any_done=False)
    named = rollout["next", "flow_probabilities"]
    assert torch.allclose(named, classifier(rollout["next", "lateral_line"]).softmax(-1))
    assert rollout["observation_stack"].shape[-1] == task.num_stacked * (task.n_obs + 2)
