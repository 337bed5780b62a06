"""Write files atomically and alone, and read files of tensors that cannot run code."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from fishrl.locks import take_lock


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


def find_cache(name: str) -> Path | None:
    """Return ``~/.cache/fishrl/<name>``, or that in ``XDG_CACHE_HOME``; None for a relative one."""
    caches = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    return Path(caches, "fishrl", name) if os.path.isabs(caches) else None


def check_folder(path: str | os.PathLike[str]) -> Path:
    """Return the path of a file to write; raise OSError if it cannot be written."""
    target = Path(path).expanduser()
    folder = target.absolute().parent
    if not folder.is_dir():
        raise FileNotFoundError(f"no folder {target.parent}: make it first")
    if target.is_dir() or target.is_symlink() or not os.access(folder, os.W_OK | os.X_OK):
        raise OSError(f"{target}: cannot be written; choose another file")
    return target


@contextmanager
def claim_file(path: str | os.PathLike[str] | None) -> Iterator[Path | None]:
    """Hold a file that will be written once the work for it is done; None holds nothing.

    Errors are those of ``claim``.
    """
    if path is None:
        yield None
    else:
        with claim(check_folder(path)) as target:
            yield target


@contextmanager
def claim(path: Path) -> Iterator[Path]:
    """Hold a file or folder that will be written, and yield its path.

    Its folder is made. A hidden file next to it is locked, and goes with the block.

    Raises:
        ValueError: if another block holds it, in any process.
        OSError: if it cannot be written.
    """
    place = path.absolute()
    lock = place.with_name(f".{place.name}.lock")
    is_ours = False
    while not is_ours:
        try:
            lock.parent.mkdir(parents=True, exist_ok=True)
            file = lock.open("a")
        except OSError as error:
            raise OSError(
                f"{path}: cannot be written ({error.strerror}); choose another folder, or change "
                "its permissions"
            ) from error
        with file:
            if not take_lock(file):
                raise ValueError(
                    f"{path}: is being written already; wait until that has ended, or choose "
                    "another name"
                )
            with suppress(FileNotFoundError):  # its last holder has just let go
                is_ours = os.path.samestat(os.fstat(file.fileno()), lock.stat())
            if is_ours:
                try:
                    yield path
                finally:
                    with suppress(OSError):  # on Windows, where it is open
                        lock.unlink()


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
    except (MemoryError, torch.OutOfMemoryError):
        raise
    except Exception as error:  # damaged bytes make torch's unpickler raise any
        raise ValueError(f"{what} {file}: cannot be read; {remedy}") from error
