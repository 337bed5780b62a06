"""Save and load everything a run needs to go on, and say clearly why something does not load."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from torchrl.checkpoint import Checkpoint, CheckpointError, StateDictCheckpointAdapter


@dataclass(frozen=True, kw_only=True)
class BrainOf:
    """What a brain was made for; brains of another task or another size do not fit.

    Args:
        task: name of the task's class.
        num_inputs: length of the stacked observation.
        num_actions: number of actions.
    """

    task: str
    num_inputs: int
    num_actions: int

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
        )

    def check(self, metadata: Mapping[str, Any], *, path: Path) -> None:
        """Compare with the metadata of a checkpoint.

        Raises:
            ValueError: if the checkpoint is of another task or size.
        """
        for key, wanted, remedy in (
            ("task", self.task, "choose the task the checkpoint was made for with task=..."),
            ("num_inputs", self.num_inputs, "the observation of the task has changed since"),
            ("num_actions", self.num_actions, "the actions of the task have changed since"),
        ):
            if metadata.get(key) != wanted:
                raise ValueError(
                    f"checkpoint {path}: it is of {key} = {metadata.get(key)!r}, here it is "
                    f"{wanted!r}; {remedy}, or train anew"
                )


def save_checkpoint(
    path: Path,
    components: Mapping[str, Any],
    *,
    brain: BrainOf,
    preset: str,
    frames: int,
    config: Mapping[str, Any],
) -> None:
    """Write the components' states to a folder, replacing it only when all is written.

    Args:
        path: the folder.
        components: objects with ``state_dict`` and ``load_state_dict``.
        brain: task and sizes, compared on loading.
        preset: name of the preset.
        frames: env frames so far.
        config: the whole configuration.
    """
    for debris in path.parent.glob(f".{path.name}.stage-*"):  # of a process killed while writing
        shutil.rmtree(debris, ignore_errors=True)
    _checkpoint(components).save(
        path,
        metadata={
            "task": brain.task,
            "num_inputs": brain.num_inputs,
            "num_actions": brain.num_actions,
            "preset": preset,
            "frames": frames,
            "config": config,
        },
    )
    for debris in path.parent.glob(f".{path.name}.backup-*"):
        shutil.rmtree(debris, ignore_errors=True)


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
        # Killed between the two renames that replace a checkpoint: the old one still lies there.
        found = next(iter(sorted(folder.parent.glob(f".{folder.name}.backup-*"))), folder)
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
    return ValueError(
        f"checkpoint {path}: corrupt or not a checkpoint ({reason}); take another one, such as "
        "checkpoints/last or checkpoints/best of the run"
    )
