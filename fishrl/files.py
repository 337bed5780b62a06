"""Write files atomically, and read files of tensors that cannot run code."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator, Mapping
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
    path: str | Path,
    *,
    what: str,
    remedy: str,
    like: Mapping[str, str] | None = None,
    device: str = "cpu",
) -> Any:
    """Read a file of ``torch.save``; it cannot run code (``weights_only``).

    The checksums in the file, CRC-32 of each part, are compared; ``torch.load`` does not.

    Args:
        path: path of the file.
        what: what the file should hold, for messages.
        remedy: what to do about a file that holds nothing or something else.
        like: the tensors that it should hold, see ``find_misfit``; None for anything.
        device: device of the tensors.

    Raises:
        ValueError: in one line, for a missing or damaged file, and for other tensors.
    """
    import torch  # heavy, and not needed to write

    file = Path(path).expanduser()
    try:
        with zipfile.ZipFile(file) as parts:
            if parts.testzip() is not None:
                raise ValueError("it has changed since it was written")
        content = torch.load(file, map_location=device, weights_only=True)
        problem = "" if like is None else find_misfit(content, like)
    except FileNotFoundError as error:
        raise ValueError(f"{what} {file}: no such file; {remedy}") from error
    except Exception as error:  # damaged bytes make torch's unpickler raise any
        raise ValueError(f"{what} {file}: cannot be read; {remedy}") from error
    if problem:
        raise ValueError(f"{what} {file}: the file holds something else ({problem}); {remedy}")
    return content


def find_misfit(content: Any, like: Mapping[str, str]) -> str:
    """Return which tensor by name is not as in ``like``; nothing if all are.

    ``like`` has their dtype and shape as ``describe_tensor`` returns them, so that none may hold
    NaN or infinity, or the dtype alone, which allows both and any shape.
    """
    entries = content if isinstance(content, dict) else {"content": content}
    found = {name: describe_tensor(value) for name, value in entries.items()}
    for name in {**like, **found}:
        got, wanted = found.get(name, "missing"), like.get(name, "nothing")
        if wanted not in (got, got.partition(" ")[0]):
            return f"{name} is {got}, expected is {wanted}"
    return ""


def describe_tensor(value: Any) -> str:
    """Return dtype and shape as ``float32 [2, 3]``, followed by whether a number is not finite."""
    import torch

    if not isinstance(value, torch.Tensor) or value.is_meta or value.layout != torch.strided:
        return f"a {type(value).__name__}"
    note = "" if value.isfinite().all() else " with NaN or infinity"
    return f"{value.dtype} {list(value.shape)}{note}".removeprefix("torch.")
