"""Write files atomically, and read files of tensors that cannot run code."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any


@contextmanager
def staged(path: Path) -> Iterator[Path]:
    """Yield a temporary path of the same name; the file written there replaces ``path`` at the end.

    A reader sees the previous file or the new one, never a part. After an error the previous file
    stays. A symbolic link at ``path`` is replaced, not followed.
    """
    with TemporaryDirectory(prefix=".", dir=path.parent) as folder:
        stage = Path(folder) / path.name
        yield stage
        stage.replace(path)


def write_whole(path: Path, text: str) -> None:
    """Write a file completely, or leave it unchanged and raise OSError."""
    with staged(path) as stage:
        stage.write_text(text, encoding="utf-8")


def load_tensors(
    path: str | Path, *, what: str, remedy: str, device: str = "cpu", maps: bool = False
) -> Any:
    """Read a file of ``torch.save``; it cannot run code (``weights_only``).

    The checksums in the file, CRC-32 of each part, are compared; ``torch.load`` does not. With
    ``maps`` tensors of a CPU stay in the file, which must not change, until they are copied.

    Raises:
        ValueError: for a missing or damaged file, naming ``what`` it should hold and the remedy.
    """
    import torch  # heavy, and not needed to write

    file = Path(path).expanduser()
    try:
        with zipfile.ZipFile(file) as parts:
            if parts.testzip() is not None:
                raise ValueError("it has changed since it was written")
        return torch.load(file, map_location=device, weights_only=True, mmap=maps)
    except FileNotFoundError as error:
        raise ValueError(f"{what} {file}: no such file; {remedy}") from error
    except Exception as error:  # damaged bytes make torch's unpickler raise any
        raise ValueError(f"{what} {file}: cannot be read; {remedy}") from error
