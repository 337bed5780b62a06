"""A checkpoint is whole or not there, of the right task, unchanged, and cannot run code."""

import logging
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from fishrl.training.checkpoint import Checkpoint, CheckpointNotWritten, save_checkpoint, write_sums
from fishrl.training.loop import Training
from fishrl.training.policy_spec import PolicySpec
from tests.training.conftest import QUICK, Toy, limited_disk, read_rows

SPEC = PolicySpec(task="Predation", num_inputs=16, num_actions=3)


def save(path: Path, *, value: float = 1.0) -> torch.nn.Linear:
    net = torch.nn.Linear(3, 2)
    torch.nn.init.constant_(net.weight, value)
    save_checkpoint(path, {"net": net}, spec=SPEC, frames=7, config={"preset": "small"})
    return net


def load(path: Path) -> torch.nn.Linear:
    net = torch.nn.Linear(3, 2)
    Checkpoint.find(path).load({"net": net}, spec=SPEC)
    return net


def test_newer_checkpoint_replaces_old_and_leaves_no_debris(tmp_path: Path) -> None:
    (tmp_path / "..last.new").mkdir()  # of a process killed while writing
    save(tmp_path / "last", value=1.0)
    net = save(tmp_path / "last", value=2.0)
    assert torch.equal(load(tmp_path / "last").weight, net.weight)
    found = Checkpoint.find(tmp_path / "last")
    assert (found.manifest.metadata.task, found.frames) == ("Predation", 7)
    assert found.config == {"preset": "small"}
    assert [path.name for path in tmp_path.iterdir()] == ["last"]


def test_folder_of_something_else_is_not_replaced(tmp_path: Path) -> None:
    """As ``--folder runs`` would, instead of ``--folder runs/student``."""
    (tmp_path / "runs" / "first").mkdir(parents=True)
    with pytest.raises(ValueError, match="runs: holds something else than a checkpoint"):
        save(tmp_path / "runs")
    assert [path.name for path in (tmp_path / "runs").iterdir()] == ["first"]
    assert [path.name for path in tmp_path.iterdir()] == ["runs"]


def test_checkpoint_renamed_before_a_kill_is_found(tmp_path: Path) -> None:
    save(tmp_path / "last")
    (tmp_path / "last").rename(tmp_path / "last-000000007")
    assert Checkpoint.find(tmp_path / "last").frames == 7
    save(tmp_path / "last", value=2.0)
    assert (load(tmp_path / "last").weight == 2.0).all()


def test_run_folder_gives_best_else_last_checkpoint(tmp_path: Path) -> None:
    save(tmp_path / "checkpoints" / "last")
    assert Checkpoint.find(tmp_path).path.name == "last"
    save(tmp_path / "checkpoints" / "best")
    assert Checkpoint.find(tmp_path).path.name == "best"
    (tmp_path / "checkpoints" / "best").rename(tmp_path / "checkpoints" / "best-000000007")
    assert Checkpoint.find(tmp_path).path.name == "best-000000007"  # killed between the renames


@pytest.mark.parametrize(
    ("name", "value"), [("num_stacked", 4), ("task", "Other"), ("is_continuous", True)]
)
def test_checkpoint_of_other_sizes_is_refused(tmp_path: Path, name: str, value: Any) -> None:
    save(tmp_path / "best")
    other = replace(SPEC, **{name: value})
    with pytest.raises(ValueError, match=f"trained with {name} = .*, the current one is {value!r}"):
        Checkpoint.find(tmp_path / "best").load({"net": torch.nn.Linear(3, 2)}, spec=other)


@pytest.mark.parametrize(
    "error", [ChildProcessError("collector 1 is gone"), RuntimeError("a flow worker failed")]
)
def test_only_disk_errors_are_reported_as_such(tmp_path: Path, error: Exception) -> None:
    class Broken(torch.nn.Linear):
        def state_dict(self, *_: Any, **__: Any) -> dict[str, Any]:
            raise error

    with pytest.raises(type(error), match=str(error)):
        save_checkpoint(tmp_path / "last", {"net": Broken(3, 2)}, spec=SPEC, frames=7, config={})
    assert not (tmp_path / "last").exists()


@pytest.mark.parametrize(
    ("owner", "kind"),
    [
        (torch, torch.OutOfMemoryError),
        (torch.nn.Linear, MemoryError),
        (torch.nn.Linear, ChildProcessError),
    ],
)
def test_only_errors_of_the_files_blame_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, owner: Any, kind: type[Exception]
) -> None:
    def fail(*_: Any, **__: Any) -> None:
        raise kind("while loading")

    save(tmp_path / "last")
    monkeypatch.setattr(owner, "load" if owner is torch else "load_state_dict", fail)
    with pytest.raises(kind, match=r"^while loading"):
        load(tmp_path / "last")


def test_file_that_is_missing_cut_or_changed_is_noticed(tmp_path: Path) -> None:
    save(tmp_path / "last")
    files = [path for path in (tmp_path / "last").rglob("*") if path.is_file()]
    assert sorted(path.name for path in files) == ["SHA256SUMS", "manifest.json", "state.pt"]
    for file in files:
        before = file.read_bytes()
        wrong: list[bytes | None] = [None, before[: len(before) // 2], b"{", b"[1, 2]"]
        for place in (*range(0, len(before), max(1, len(before) // 12)), len(before) - 1):
            flipped = before[place] ^ 1 << place % 8
            wrong.append(before[:place] + bytes([flipped]) + before[place + 1 :])
        for content in wrong:
            file.unlink() if content is None else file.write_bytes(content)
            with pytest.raises(ValueError, match="corrupt or not a checkpoint"):
                load(tmp_path / "last")
            file.write_bytes(before)
    load(tmp_path / "last")


class Evil:
    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple[Callable[[str], int], tuple[str]]:
        return os.system, (f"touch {self.mark}",)


def test_checkpoint_cannot_run_code(tmp_path: Path) -> None:
    save(tmp_path / "last")
    torch.save(Evil(tmp_path / "ran"), next((tmp_path / "last").rglob("state.pt")))
    write_sums(tmp_path / "last")  # as an attacker would
    with pytest.raises(ValueError, match="corrupt or not a checkpoint"):
        load(tmp_path / "last")
    assert not (tmp_path / "ran").exists()


def test_run_without_whole_checkpoint_restarts(toy: Toy, monkeypatch: pytest.MonkeyPatch) -> None:
    def end(file: Path) -> str:
        raise KeyboardInterrupt

    training = toy.begin(name="run", **QUICK)
    monkeypatch.setattr("fishrl.training.checkpoint._sum", end)
    with pytest.raises(KeyboardInterrupt):
        training.run()
    training.close()
    monkeypatch.undo()
    assert not training.folder.has_begun()
    folder = toy.folder / "run" / "checkpoints"
    (folder / "..last.new").mkdir()  # as SIGKILL leaves it
    toy.reopen("run", total_frames=40).run()
    assert not list(folder.glob(".*"))
    assert [row["frames"] for row in toy.rows("run")] == ["40"]


def test_run_survives_a_full_disk(
    toy: Toy, whole: Training, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    training = toy.begin(name="run", **QUICK)
    run, conclude = toy.folder / "run", Training._conclude

    def conclude_on_a_full_disk(self: Training, metrics: dict[str, float]) -> None:
        if not 80 < self.counters.frames < 200:
            conclude(self, metrics)
            return
        with limited_disk((run / "metrics.csv").stat().st_size):
            conclude(self, metrics)
        assert Checkpoint.read(run / "checkpoints" / "last").frames == 80

    monkeypatch.setattr(Training, "_conclude", conclude_on_a_full_disk)
    with caplog.at_level(logging.ERROR, logger="fishrl"):
        training.run()
    assert "best: cannot be written" in caplog.text
    assert "metrics.csv: 1 rows cannot be written (File too large)" in caplog.text
    assert toy.rows("run") == read_rows(whole.folder.path)
    assert Checkpoint.read(run / "checkpoints" / "last").frames == 240
    monkeypatch.undo()
    longer = toy.reopen("run", total_frames=280)
    with limited_disk(2000), pytest.raises(CheckpointNotWritten, match="is unchanged"):
        longer.run()
