"""Write files atomically and into the folder that was named, and read files of tensors safely."""

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import torch


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


def check_names(folder: Path) -> Path:
    """Return a folder of results that may be written into, with all that it holds.

    Its files may come from others, and writing to a symbolic link changes what it leads to.

    Raises:
        ValueError: for links in it that lead out of it, and for names that cannot be printed.
    """
    root = folder.resolve()
    for place, folders, files in os.walk(root):
        for path in (Path(place), *(Path(place, name) for name in (*folders, *files))):
            if not path.name.isprintable():
                raise ValueError(f"{folder}: holds {path.name!r}; rename or delete it")
            if path.is_symlink() and not path.resolve().is_relative_to(root):
                raise ValueError(
                    f"{path}: is a link that leads out of {folder}; delete it, or replace it by "
                    "what it links to"
                )
        if "wandb" in folders:  # whose files are always new, and link to a cache
            folders.remove("wandb")
    return folder


def make_folder(folder: Path) -> Path:
    """Make a folder for results unless there is one; errors are those of ``check_names``."""
    folder.mkdir(parents=True, exist_ok=True)
    return check_names(folder)


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
