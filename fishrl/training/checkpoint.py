"""Save and load everything a run needs to go on, and say clearly why something does not load."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from torchrl.checkpoint import Checkpoint, CheckpointError, StateDictCheckpointAdapter

from fishrl.training.run_folder import refuse_many


@dataclass(frozen=True, kw_only=True)
class BrainOf:
    """What a brain was made for; brains of another task or another size do not fit.

    Args:
        task: name of the task's class.
        num_inputs: length of the stacked observation.
        num_actions: number of actions.
        num_stacked: observations in a stack.
    """

    task: str
    num_inputs: int
    num_actions: int
    num_stacked: int = 1

    @property
    def num_observed(self) -> int:
        """Length of one observation."""
        return self.num_inputs // self.num_stacked

    @classmethod
    def task_of(cls, task: Any, *, num_told: int = 0) -> BrainOf:
        """Describe the brain that a task needs.

        Args:
            task: what the fish does.
            num_told: numbers that transforms put behind each observation.
        """
        return cls(
            task=type(task).__name__,
            num_inputs=(task.n_obs + num_told) * task.num_stacked,
            num_actions=task.num_actions,
            num_stacked=task.num_stacked,
        )

    def check(self, metadata: Mapping[str, Any], *, path: Path) -> None:
        """Compare with the metadata of a checkpoint.

        Raises:
            ValueError: if the checkpoint is of another task or size.
        """
        changed = "a setting of the task changes its {}: leave that away; or its code has changed"
        for key, wanted, remedy in (
            ("task", self.task, "choose the task the checkpoint was made for with task=..."),
            ("num_inputs", self.num_inputs, changed.format("observation")),
            ("num_actions", self.num_actions, changed.format("actions")),
        ):
            if metadata.get(key) != wanted:
                raise ValueError(
                    f"checkpoint {path}: it is of {key} = {metadata.get(key)!r}, here it is "
                    f"{wanted!r}; {remedy}, or train anew"
                )


class CheckpointNotWritten(OSError):
    """A checkpoint could not be written; the one before it is as it was."""


def save_checkpoint(
    path: Path,
    components: Mapping[str, Any],
    *,
    brain: BrainOf,
    preset: str | None,
    frames: int,
    config: Mapping[str, Any],
    keep: int = 1,
) -> None:
    """Write the components' states to a folder, replacing it only when all is on the disk.

    Args:
        path: the folder.
        components: objects with ``state_dict`` and ``load_state_dict``.
        brain: task and sizes, compared on loading.
        preset: name of the preset.
        frames: env frames so far.
        config: the whole configuration.
        keep: how many checkpoints stay, this one included; older ones get their frames behind
            their name.

    Raises:
        CheckpointNotWritten: if the disk is full or the folder cannot be written.
    """
    fresh = path.with_name(f".{path.name}.new")
    metadata = {
        "task": brain.task,
        "num_inputs": brain.num_inputs,
        "num_actions": brain.num_actions,
        "preset": preset,
        "frames": frames,
        "config": config,
    }
    try:
        if fresh.exists() and not path.exists():  # killed between the renames: it is the newest
            os.replace(fresh, path)
        _clear(path)
        _checkpoint(components).save(fresh, metadata=metadata)
        for file in fresh.rglob("*"):
            _flush(file)
        _put_in_place(fresh, path, keep=keep)
    except (OSError, RuntimeError) as error:
        if not _is_of_the_disk(error):
            raise
        _clear(path)
        raise _not_written(path, error) from error


def _put_in_place(fresh: Path, path: Path, *, keep: int) -> None:
    """Let a complete checkpoint take its place; at any moment a complete one can be found."""
    older = path.with_name(f".{path.name}.backup")
    if path.exists():
        frames = _read_frames(path)
        if keep > 1 and frames is not None and frames != _read_frames(fresh):
            older = path.with_name(f"{path.name}-{frames:09d}")
        if older.exists():
            shutil.rmtree(older)
        os.replace(path, older)
    os.replace(fresh, path)
    _flush(path.parent)
    for former in _list_older(path)[keep - 1 :]:
        shutil.rmtree(former, ignore_errors=True)
    shutil.rmtree(path.with_name(f".{path.name}.backup"), ignore_errors=True)


def _clear(path: Path) -> None:
    """Remove what a process that was killed while writing left; it is no use beside the place."""
    if path.exists():
        for debris in (*path.parent.glob(f".{path.name}.*"), *path.parent.glob(f"..{path.name}.*")):
            shutil.rmtree(debris, ignore_errors=True)


def _list_older(path: Path) -> list[Path]:
    """List the checkpoints before one, newest first."""
    return sorted(path.parent.glob(f"{path.name}-" + "[0-9]" * 9), reverse=True)


def _read_frames(path: Path) -> int | None:
    """Return the frames of a checkpoint, or None if it does not say."""
    try:
        return int(Checkpoint.manifest(path)["metadata"]["frames"])
    except (CheckpointError, OSError, ValueError, TypeError, KeyError):
        return None


def _flush(path: Path) -> None:
    """Wait until a file or folder is on the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _is_of_the_disk(error: Exception) -> bool:
    """Tell whether writing failed; torch's writer says so with a RuntimeError."""
    words = ("inline_container", "iostream error")
    return isinstance(error, OSError) or any(word in str(error) for word in words)


def _not_written(path: Path, error: Exception) -> CheckpointNotWritten:
    known = isinstance(error, OSError) and error.strerror
    reason = error.strerror if known else "writing failed"  # type: ignore[attr-defined]
    if not known and path.parent.is_dir():
        reason = f"writing failed with {shutil.disk_usage(path.parent).free / 1e6:.1f} MB free"
    frames = _read_frames(path) if path.exists() else None
    kept = "there is none yet" if frames is None else f"the one of frame {frames} is still there"
    return CheckpointNotWritten(
        f"checkpoint {path}: cannot be written ({reason}); {kept}: free space, or change the "
        "permissions of the folder"
    )


def read_metadata(path: str | Path, *, which: str = "best") -> tuple[Path, dict[str, Any]]:
    """Find a checkpoint and read what it says about itself.

    Args:
        path: a checkpoint, or the folder of a run.
        which: ``best`` (the last where there is none) or ``last``, for the folder of a run.

    Raises:
        ValueError: if there is none or it is corrupt.
    """
    folder = Path(path).expanduser()
    if (folder / "config.yaml").is_file() or (folder / "checkpoints").is_dir():
        folder = folder / "checkpoints"
        folder /= which if (folder / which).exists() else "last"
    found = folder
    if not found.exists():
        # Killed between the renames that replace a checkpoint, or the newest one was deleted.
        complete = [folder.with_name(f".{folder.name}.new")]
        complete += sorted(folder.parent.glob(f".{folder.name}.backup*")) + _list_older(folder)
        found = next((place for place in complete if place.exists()), folder)
    refuse_many(found, setting="checkpoint")
    if not found.exists():
        raise ValueError(
            f"checkpoint {folder}: there is none; give the folder of a run, or one of its "
            "checkpoints/best and checkpoints/last"
        )
    try:
        metadata = Checkpoint.manifest(found).get("metadata")
    except (CheckpointError, OSError, ValueError, TypeError, AttributeError) as error:
        raise _corrupt(found, error) from error
    if not isinstance(metadata, dict) or "task" not in metadata:
        raise _corrupt(found, "it does not name its task")
    return found, metadata


def load_checkpoint(
    path: str | Path,
    components: Mapping[str, Any],
    *,
    brain: BrainOf,
    device: str = "cpu",
    which: str = "best",
) -> dict[str, Any]:
    """Load components' states and return the metadata.

    Files are read with ``weights_only=True``: a checkpoint cannot run code.

    Args:
        path: a checkpoint, or the folder of a run.
        components: what to load; others in the checkpoint are left alone.
        brain: task and sizes the checkpoint must be of.
        device: where tensors go.
        which: ``best`` (the last where there is none) or ``last``, for the folder of a run.

    Raises:
        ValueError: if it is missing, corrupt, or of another task.
    """
    found, metadata = read_metadata(path, which=which)
    brain.check(metadata, path=found)
    try:
        _checkpoint(components).load(
            found, map_location=device, tensor_load_kwargs={"weights_only": True}
        )
    except (CheckpointError, OSError, RuntimeError, ValueError, KeyError, TypeError) as error:
        raise _corrupt(found, error) from error
    return metadata


def _checkpoint(components: Mapping[str, Any]) -> Checkpoint:
    checkpoint = Checkpoint()
    for name, component in components.items():
        checkpoint.register(name, component, adapter=StateDictCheckpointAdapter("torch"))
    return checkpoint


def _corrupt(path: Path, reason: object) -> ValueError:
    older = [place.name for place in _list_older(path)]
    remedy = f"; or delete it, and {older[0]} takes its place" if older else ""
    return ValueError(
        f"checkpoint {path}: corrupt or not a checkpoint ({reason}); take another one, such as "
        f"checkpoints/last or checkpoints/best of the run{remedy}"
    )
