"""Files of tensors are read only as they were written."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import pytest
import torch

from fishrl.files import load_tensors, staged

WEIGHTS = {"weight": torch.ones(2, 3)}
LIKE = {"weight": "float32 [2, 3]"}


def load(path: Path) -> Any:
    return load_tensors(path, what="weights", remedy="delete it", like=LIKE)


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


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ({"weight": torch.ones(3, 3)}, r"weight is float32 \[3, 3\], expected is float32 \[2, 3\]"),
        ({"weight": torch.full((2, 3), torch.nan)}, "with NaN or infinity"),
        (WEIGHTS | {"bias": torch.ones(1)}, "bias is float32"),
        (3, "weight is missing"),
        (None, "no such file; delete it"),
    ],
)
def test_other_content_is_refused_with_the_remedy(tmp_path: Path, content: Any, said: str) -> None:
    if content is not None:
        torch.save(content, tmp_path / "weights.pt")
    with pytest.raises(ValueError, match=said):
        load(tmp_path / "weights.pt")


def test_failed_write_keeps_the_previous_file(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("before")
    with pytest.raises(FileNotFoundError), staged(tmp_path / "a") as stage:
        stage.parent.joinpath("other").write_text("a")  # not the file itself
    assert (tmp_path / "a").read_text() == "before"
    assert [path.name for path in tmp_path.iterdir()] == ["a"]
