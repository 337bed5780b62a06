"""Save and load everything a run needs to continue.

A checkpoint is a folder that TorchRL's ``Checkpoint`` writes, ``manifest.json`` with metadata and
one ``state.pt`` per component, and ``SHA256SUMS`` of all these files (``sha256sum -c`` reads it).
Loading runs no code from it: each state is read from that one file, see ``load_tensors``, after its
checksum and the manifest's were compared.
"""

import hashlib
import os
import shutil
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Self

import torch
from pydantic import Field, PositiveInt
from torchrl import checkpoint as torchrl_checkpoint

from fishrl.files import load_tensors, write_whole
from fishrl.training.policy_spec import CHECKED, PolicySpec
from fishrl.training.run_folder import (
    Count,
    RunFolder,
    Stored,
    Tree,
    complete_settings,
    read_plain,
    refuse_many,
)
from fishrl.zoo import find_folder

MANIFEST, SUMS = "manifest.json", "SHA256SUMS"


class _Metadata(Stored):
    task: str
    is_continuous: bool
    num_inputs: PositiveInt
    num_stacked: PositiveInt
    num_actions: PositiveInt
    frames: Count
    config: Tree


class _Component(Stored):
    path: Annotated[str, Field(pattern=r"^components/[\w-]+$")]


class _Manifest(Stored):
    """The entries of TorchRL's ``manifest.json`` that are read."""

    components: dict[str, _Component]
    metadata: _Metadata


class CheckpointNotWritten(OSError):
    """A checkpoint could not be written; the previous one is unchanged."""


def save_checkpoint(
    path: Path,
    components: Mapping[str, Any],
    *,
    spec: PolicySpec,
    frames: int,
    config: Mapping[str, Any],
    keep: int = 1,
) -> None:
    """Write the components' states to a folder, replacing it only once they are on the disk.

    Components have ``state_dict`` and ``load_state_dict``. The ``keep`` - 1 checkpoints before
    stay, with their frames appended to the name.

    Raises:
        CheckpointNotWritten: if the disk is full or the folder cannot be written.
    """
    stage = path.with_name(f"..{path.name}.new") / "whole"
    metadata = {
        **{name: getattr(spec, name) for name in CHECKED},
        "frames": frames,
        "config": config,
    }
    try:
        shutil.rmtree(stage.parent, ignore_errors=True)  # of a process killed while writing
        checkpoint = torchrl_checkpoint.Checkpoint()
        adapter = torchrl_checkpoint.StateDictCheckpointAdapter("torch")
        for name, component in components.items():
            checkpoint.register(name, component, adapter=adapter)
        checkpoint.save(stage, metadata=metadata)
        write_sums(stage)
        for file in (stage, *stage.rglob("*")):
            _flush(file)
        _put_in_place(stage, path, frames=frames, keep=keep)
    except ChildProcessError:  # of a collector, while it was asked for its state
        raise
    except (OSError, RuntimeError) as error:
        # torch's writer reports a full disk with a RuntimeError
        words = ("inline_container", "iostream error")
        if isinstance(error, RuntimeError) and not any(word in str(error) for word in words):
            raise
        reason = getattr(error, "strerror", None)
        if reason is None:
            reason = f"{shutil.disk_usage(path.parent).free / 1e6:.1f} MB are free"
        raise CheckpointNotWritten(
            f"checkpoint {path}: cannot be written ({reason}); the previous one is unchanged: "
            "free space, or change the permissions of the folder"
        ) from error
    finally:
        shutil.rmtree(stage.parent, ignore_errors=True)


def write_sums(folder: Path) -> None:
    """Write the checksums of all files in a checkpoint but its model card, which may change."""
    apart = (folder / SUMS, folder / "README.md")
    files = [file for file in sorted(folder.rglob("*")) if file.is_file() and file not in apart]
    lines = [f"{_sum(file)}  {file.relative_to(folder).as_posix()}\n" for file in files]
    write_whole(folder / SUMS, "".join(lines))


@dataclass(frozen=True)
class Checkpoint:
    """A checkpoint on the disk, as its manifest describes it."""

    path: Path  #: its folder
    manifest: _Manifest  #: its components and metadata

    @classmethod
    def find(cls, path: str | Path) -> Self:
        """Read a checkpoint, ``zoo/<name>``, or the best one of a run folder (else the last).

        Errors are those of ``read``.
        """
        folder = find_folder(path)
        if (folder / "config.yaml").is_file() or (folder / "checkpoints").is_dir():
            run = RunFolder(folder)
            return cls.read(run.best if _list_complete(run.best) else run.last)
        return cls.read(folder)

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read the manifest of a checkpoint.

        Raises:
            ValueError: if it is missing or corrupt.
        """
        found = next(iter(_list_complete(path)), path)
        refuse_many(found, setting="checkpoint")
        if not any((found / name).is_file() for name in (MANIFEST, SUMS)):
            raise ValueError(
                f"checkpoint {path}: there is none; give the folder of a run, or one of its "
                "checkpoints/best and checkpoints/last"
            )
        try:
            manifest = _read_manifest(found)
            _check_files(found, [MANIFEST])
        except (OSError, ValueError) as error:
            raise _corrupt(found, error) from error
        return cls(found, manifest)

    @property
    def frames(self) -> int:
        """Frames of the training at which it was saved."""
        return self.manifest.metadata.frames

    @cached_property
    def config(self) -> dict[str, Any]:
        """Settings of the run, see ``Plan.from_config``."""
        return complete_settings(self.manifest.metadata.config, self.path)

    @cached_property
    def files(self) -> dict[str, Path]:
        """File of each component's state; ValueError if one is missing or damaged."""
        components = self.manifest.components.items()
        files = {name: f"{part.path}/state.pt" for name, part in components}
        try:
            _check_files(self.path, files.values())
        except (OSError, ValueError) as error:
            raise _corrupt(self.path, error) from error
        return {name: self.path / file for name, file in files.items()}

    def load(self, components: Mapping[str, Any], *, spec: PolicySpec, device: str = "cpu") -> None:
        """Load components' states.

        Raises:
            ValueError: if one is corrupt, or not of the task and sizes of ``spec``.
            ChildProcessError: if a process of the flows dies.
        """
        spec.check(self.manifest.metadata.model_dump(), path=self.path)
        files = self.files
        try:
            for name, component in components.items():
                remedy = "it is of another version"
                # a buffer is copied, and would be in memory twice
                state = load_tensors(
                    files[name], what=name, remedy=remedy, device=device, maps=True
                )
                component.load_state_dict(state)
        except (MemoryError, torch.OutOfMemoryError, ChildProcessError):  # the files are good
            raise
        except Exception as error:  # states of other versions raise any
            raise _corrupt(self.path, error) from error


def _read_manifest(path: Path) -> _Manifest:
    manifest: _Manifest = read_plain(path / MANIFEST, _Manifest, what="a manifest")
    return manifest


def _check_files(folder: Path, names: Iterable[str]) -> None:
    """Compare files with their checksums; a missing one counts as damage."""
    lines = (folder / SUMS).read_text(encoding="utf-8").split("\n")
    sums = {name: value for value, _, name in (line.partition("  ") for line in lines)}
    for name in names:
        if not (folder / name).is_file():
            raise ValueError(f"{name} is missing")
        if sums.get(name) != _sum(folder / name):
            raise ValueError(f"{name} has changed since it was written")


def _sum(file: Path) -> str:
    with file.open("rb") as content:
        return hashlib.file_digest(content, "sha256").hexdigest()


def _put_in_place(stage: Path, path: Path, *, frames: int, keep: int) -> None:
    """Rename a complete checkpoint to ``path``; a complete one can be found at any moment."""
    is_first = not any(path.glob("*"))
    if not is_first and not any((path / name).is_file() for name in (MANIFEST, SUMS)):
        raise ValueError(f"{path}: holds something else than a checkpoint; name another folder")
    if not is_first:
        previous = _name_older(path, _read_frames(path))
        shutil.rmtree(previous, ignore_errors=True)
        os.replace(path, previous)
    os.replace(stage, path)
    _flush(path.parent)
    if not is_first:
        same = _name_older(path, frames)
        older = [place for place in _list_older(path) if place != same]
        for unneeded in (same, *older[keep - 1 :]):
            shutil.rmtree(unneeded, ignore_errors=True)


def _name_older(path: Path, frames: int) -> Path:
    return path.with_name(f"{path.name}-{frames:09d}")


def _list_older(path: Path) -> list[Path]:
    return sorted(path.parent.glob(f"{path.name}-" + "[0-9]" * 9), reverse=True)


def _list_complete(path: Path) -> list[Path]:
    """List the checkpoints of a name, newest first: after a kill or a deletion an older one."""
    return [place for place in (path, *_list_older(path)) if place.exists()]


def _read_frames(path: Path) -> int:
    """Return the frames of a checkpoint, 0 if it is damaged."""
    try:
        return _read_manifest(path).metadata.frames
    except (OSError, ValueError):
        return 0


def _flush(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _corrupt(path: Path, reason: object) -> ValueError:
    older, reason = [place.name for place in _list_older(path)], " ".join(str(reason).split())
    remedy = f"; or delete it, and {older[0]} takes its place" if older else ""
    return ValueError(
        f"checkpoint {path}: corrupt or not a checkpoint ({reason}); use another one, such as "
        f"checkpoints/last or checkpoints/best of the run{remedy}"
    )
