"""Files of tensors are read safely."""

from pathlib import Path

import pytest
import torch

from fishrl.files import load_tensors


def test_files_that_cannot_be_read_are_refused_with_the_remedy(tmp_path: Path) -> None:
    path = tmp_path / "tensors.pt"
    torch.save({"a": torch.ones(2)}, path)
    assert load_tensors(path, what="wakes", remedy="delete it")["a"].sum() == 2.0
    whole = path.read_bytes()
    for damaged in (b"not a file of torch", b"root:x:0:0:root:/root:/bin/sh", b"", whole[:-99]):
        path.write_bytes(damaged)
        with pytest.raises(ValueError, match=r"wakes .*: cannot be read; delete it"):
            load_tensors(path, what="wakes", remedy="delete it")
    path.write_bytes(whole)
    with pytest.raises(ValueError, match="the file holds something else; delete it"):
        load_tensors(path, what="wakes", remedy="delete it", entries=("a", "b"))
    with pytest.raises(ValueError, match="no such file; delete it"):
        load_tensors(tmp_path / "none", what="wakes", remedy="delete it")
