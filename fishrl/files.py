"""Write files atomically, and read files of tensors with checks."""

import os
from collections.abc import Iterator, Sequence
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


def load_tensors(
    path: str | Path, *, what: str, remedy: str, entries: Sequence[str] | None = None
) -> Any:
    """Read a file of ``torch.save`` on the CPU; it cannot run code (``weights_only``).

    Args:
        path: path of the file.
        what: what the file should hold, for messages.
        remedy: what to do about a file that holds nothing or something else.
        entries: names in the dictionary that it should hold; None for anything else.

    Raises:
        ValueError: for a missing or damaged file, and if the dictionary has other entries.
    """
    file = Path(path).expanduser()
    try:
        content = torch.load(file, map_location="cpu", weights_only=True)
    except FileNotFoundError as error:
        raise ValueError(f"{what} {file}: no such file; {remedy}") from error
    except Exception as error:  # damaged bytes make torch's unpickler raise any
        raise ValueError(f"{what} {file}: cannot be read; {remedy}") from error
    if entries is not None and not (isinstance(content, dict) and {*content} == {*entries}):
        raise ValueError(f"{what} {file}: the file holds something else; {remedy}")
    return content
