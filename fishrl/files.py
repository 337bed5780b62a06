"""Files that are whole or not there, and files of tensors that are what they should be."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch


@contextmanager
def staged(path: Path) -> Iterator[Path]:
    """Yield a temporary path next to ``path``; the file written there replaces it at the end.

    A reader sees the previous file or the new one, never a part. After an error the previous file
    stays.
    """
    stage = path.with_name(f".{path.name}.{os.getpid()}.stage")
    try:
        yield stage
        stage.replace(path)
    finally:
        stage.unlink(missing_ok=True)


def load_tensors(path: str | Path, *, what: str, remedy: str) -> Any:
    """Read a file of ``torch.save`` on the CPU; it cannot run code (``weights_only``).

    A missing or corrupt file raises ValueError, with ``what`` it should hold and the ``remedy``.
    """
    file = Path(path).expanduser()
    try:
        return torch.load(file, map_location="cpu", weights_only=True)
    except FileNotFoundError as error:
        raise ValueError(f"{what} {file}: no such file; {remedy}") from error
    except Exception as error:  # damaged bytes make torch's unpickler raise any
        raise ValueError(f"{what} {file}: cannot be read; {remedy}") from error
