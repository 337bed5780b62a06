"""What a checkpoint says when it does not fit, and that it cannot run code."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from experiments.evaluate import evaluate
from experiments.settings import EvaluateConfig, TrainConfig
from experiments.train import finish, set_up, train
from fishrl.training.checkpoint import BrainOf, load_checkpoint, read_metadata, save_checkpoint
from tests.training.toy_fish import ToyPredation, make_toy_env

TOY = {"_target_": "tests.training.toy_fish.ToyPredation"}
BRAIN = BrainOf(task="Predation", num_inputs=16, num_actions=3)


class OtherTask(ToyPredation):
    pass


class WiderTask(ToyPredation):
    n_obs = 5


WiderTask.__name__ = "ToyPredation"


def save(path: Path, *, value: float = 1.0) -> torch.nn.Linear:
    net = torch.nn.Linear(3, 2)
    torch.nn.init.constant_(net.weight, value)
    save_checkpoint(path, {"net": net}, brain=BRAIN, preset="small", frames=7, config={"a": 1})
    return net


def test_what_was_saved_is_loaded_with_its_metadata(tmp_path: Path) -> None:
    net = save(tmp_path / "last")
    fresh = torch.nn.Linear(3, 2)
    metadata = load_checkpoint(tmp_path / "last", {"net": fresh}, brain=BRAIN)
    assert torch.equal(fresh.weight, net.weight)
    assert metadata["task"] == "Predation"
    assert (metadata["preset"], metadata["frames"]) == ("small", 7)


def test_a_newer_checkpoint_replaces_the_old_one_and_leaves_no_debris(tmp_path: Path) -> None:
    (tmp_path / ".last.stage-0123").mkdir()  # of a process killed while writing
    save(tmp_path / "last", value=1.0)
    net = save(tmp_path / "last", value=2.0)
    fresh = torch.nn.Linear(3, 2)
    load_checkpoint(tmp_path / "last", {"net": fresh}, brain=BRAIN)
    assert torch.equal(fresh.weight, net.weight)
    assert [path.name for path in tmp_path.iterdir()] == ["last"]


def test_a_kill_between_two_renames_loses_nothing(tmp_path: Path) -> None:
    save(tmp_path / "last")
    os.replace(tmp_path / "last", tmp_path / ".last.backup-0123")
    found, metadata = read_metadata(tmp_path / "last")
    assert found.name == ".last.backup-0123"
    assert metadata["frames"] == 7


def test_a_run_folder_gives_its_best_checkpoint_and_before_there_is_one_the_last(
    tmp_path: Path,
) -> None:
    save(tmp_path / "checkpoints" / "last")
    assert read_metadata(tmp_path)[0].name == "last"
    save(tmp_path / "checkpoints" / "best")
    assert read_metadata(tmp_path)[0].name == "best"
    assert read_metadata(tmp_path, which="last")[0].name == "last"


def test_a_missing_checkpoint_is_an_error_that_says_what_to_give(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="there is none; give the folder of a run"):
        load_checkpoint(tmp_path / "nothing", {}, brain=BRAIN)
    (tmp_path / "checkpoints").mkdir()
    with pytest.raises(ValueError, match="there is none; give the folder of a run"):
        load_checkpoint(tmp_path, {}, brain=BRAIN)


@pytest.mark.parametrize("damage", ["no manifest", "no json", "truncated", "missing file", "list"])
def test_a_corrupt_checkpoint_is_an_error(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "last"
    save(path)
    payload = next(path.rglob("state.pt"))
    manifest = path / "manifest.json"
    if damage == "no manifest":
        manifest.unlink()
    elif damage == "no json":
        manifest.write_text("{")
    elif damage == "truncated":
        payload.write_bytes(payload.read_bytes()[:100])
    elif damage == "missing file":
        payload.unlink()
    else:
        manifest.write_text(json.dumps([1, 2]))
    with pytest.raises(ValueError, match="corrupt or not a checkpoint"):
        load_checkpoint(path, {"net": torch.nn.Linear(3, 2)}, brain=BRAIN)


def test_a_file_that_is_no_checkpoint_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "last").write_text("not a checkpoint")
    with pytest.raises(ValueError, match="corrupt or not a checkpoint"):
        read_metadata(tmp_path / "last")


def test_a_checkpoint_cannot_run_code(tmp_path: Path) -> None:
    class Evil:
        def __reduce__(self) -> tuple[Callable[[str], int], tuple[str]]:
            return os.system, (f"touch {tmp_path / 'ran'}",)

    save(tmp_path / "last")
    torch.save(Evil(), next((tmp_path / "last").rglob("state.pt")))
    with pytest.raises(ValueError, match="corrupt or not a checkpoint"):
        load_checkpoint(tmp_path / "last", {"net": torch.nn.Linear(3, 2)}, brain=BRAIN)
    assert not (tmp_path / "ran").exists()


@pytest.mark.parametrize(
    ("brain", "said"),
    [
        (BrainOf(task="Gait", num_inputs=16, num_actions=3), "task = 'Predation', here it is 'Ga"),
        (BrainOf(task="Predation", num_inputs=20, num_actions=3), "num_inputs = 16, here it is 20"),
        (BrainOf(task="Predation", num_inputs=16, num_actions=5), "num_actions = 3, here it is 5"),
    ],
)
def test_a_checkpoint_of_another_task_or_size_is_refused(
    tmp_path: Path, brain: BrainOf, said: str
) -> None:
    save(tmp_path / "last")
    with pytest.raises(ValueError, match=said):
        load_checkpoint(tmp_path / "last", {}, brain=brain)


def test_every_part_of_a_run_is_saved_without_pickle_of_code(
    toy_config: Callable[..., TrainConfig], tmp_path: Path
) -> None:
    set_up(toy_config(name="run", total_frames=8), make_env=make_toy_env).run()
    folder = tmp_path / "run" / "checkpoints" / "last"
    manifest = json.loads((folder / "manifest.json").read_text())
    parts = {"actor", "loss", "optimiser", "buffer", "collector", "rng", "counters"}
    assert set(manifest["components"]) == parts
    files = [path for path in folder.rglob("*") if path.is_file() and path.name != "manifest.json"]
    assert len(files) == len(parts)
    for path in files:
        torch.load(path, weights_only=True)


def test_a_learned_fish_is_evaluated_as_at_the_end_of_its_run(
    toy_config: Callable[..., TrainConfig], tmp_path: Path
) -> None:
    summary = train(toy_config(name="run"), make_env=make_toy_env)
    config = EvaluateConfig(
        task=TOY, preset="toy", checkpoint=str(tmp_path / "run"), episodes=10, compile=False
    )
    result = evaluate(config, make_env=make_toy_env)
    for key in ("success_rate", "mean_return", "episodes", "diverged"):
        assert result[key] == summary[key], key


@pytest.mark.parametrize(
    ("task", "said"), [("OtherTask", "it is of task"), ("WiderTask", "it is of num_inputs = 16")]
)
def test_a_fish_of_another_task_is_not_evaluated(
    toy_config: Callable[..., TrainConfig], tmp_path: Path, task: str, said: str
) -> None:
    set_up(toy_config(name="run", total_frames=8), make_env=make_toy_env).run()
    config = EvaluateConfig(
        task={"_target_": f"{__name__}.{task}"},
        preset="toy",
        checkpoint=str(tmp_path / "run"),
        compile=False,
    )
    with pytest.raises(ValueError, match=said):
        evaluate(config, make_env=make_toy_env)


def test_a_run_without_its_checkpoint_is_not_resumed(
    toy_config: Callable[..., TrainConfig], tmp_path: Path
) -> None:
    finish(set_up(toy_config(name="run", total_frames=80), make_env=make_toy_env))
    shutil.rmtree(tmp_path / "run" / "checkpoints")
    with pytest.raises(ValueError, match="there is none"):
        set_up(toy_config(resume=str(tmp_path / "run")), make_env=make_toy_env)
