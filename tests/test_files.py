"""Files of tensors are read only as they were written."""

import os
import random
import signal
from pathlib import Path
from typing import Any

import pytest
import torch

from fishrl.files import check_folder, claim, load_tensors, staged
from fishrl.locks import take_lock

WEIGHTS = {"weight": torch.ones(2, 3)}


def load(path: Path) -> Any:
    return load_tensors(path, what="weights", remedy="delete it")


def test_flipped_bits_are_never_read_as_other_numbers(tmp_path: Path) -> None:
    draw, path = random.Random(0), tmp_path / "weights.pt"
    torch.save(WEIGHTS, path)
    data = path.read_bytes()
    for _ in range(40):
        place = draw.randrange(len(data))
        flipped = data[place] ^ 1 << draw.randrange(8)
        path.write_bytes(data[:place] + bytes([flipped]) + data[place + 1 :])
        try:
            found = load(path)
        except ValueError:
            continue
        assert torch.equal(found["weight"], WEIGHTS["weight"])  # a few bits fill up the file


def test_other_files_are_refused_with_the_remedy(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no such file; delete it"):
        load(tmp_path / "weights.pt")
    (tmp_path / "weights.pt").write_text("words")
    with pytest.raises(ValueError, match="cannot be read; delete it"):
        load(tmp_path / "weights.pt")


def test_failed_write_keeps_the_previous_file(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("before")
    with pytest.raises(FileNotFoundError), staged(tmp_path / "a") as stage:
        stage.parent.joinpath("other").write_text("a")  # not the file itself
    assert (tmp_path / "a").read_text() == "before"
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_claimed_file_is_refused_until_it_is_given_up(tmp_path: Path) -> None:
    file = tmp_path / "new" / "row.json"
    for _ in range(2):
        with claim(file), pytest.raises(ValueError, match="is being written already; wait"):
            claim(file).__enter__()
        assert not list(file.parent.iterdir())


def test_forked_process_holds_no_lock(tmp_path: Path) -> None:
    file, other = ((tmp_path / "lock").open("a") for _ in range(2))
    with file, other:
        assert take_lock(file) and not take_lock(other)
        child = os.fork()
        if child == 0:
            signal.pause()
        try:
            file.close()
            assert take_lock(other, waits=True)
        finally:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)


def test_home_is_expanded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    assert check_folder("~/x.png") == tmp_path / "x.png"
