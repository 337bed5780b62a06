"""The checkpoints of a run: the last one to continue from, the best one to evaluate."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import torch
from torchrl.checkpoint import GlobalRNGState

from fishrl.training.checkpoint import CheckpointNotWritten, load_checkpoint, save_checkpoint
from fishrl.training.resolve import ResolvedRun
from fishrl.training.run_folder import RunFolder

logger = logging.getLogger(__name__)


class RNGState(GlobalRNGState):
    """The state of all random number generators.

    Generators of GPUs that this machine lacks are left out: a run continues with other GPUs or on a
    CPU, though not bit for bit.
    """

    def load_state_dict(self, state_dict: Mapping[str, Any]) -> None:
        """Restore the generators of this machine."""
        gpus = state_dict.get("torch_cuda", [])[: torch.cuda.device_count()]
        others = {name: value for name, value in state_dict.items() if name != "torch_cuda"}
        super().load_state_dict(others | ({"torch_cuda": gpus} if gpus else {}))


class Saver:
    """Save and load the checkpoints of a run.

    Args:
        resolved: the run.
        folder: where its checkpoints lie.
        components: returns by name everything that the next frame depends on.
    """

    def __init__(
        self, resolved: ResolvedRun, folder: RunFolder, components: Callable[[], dict[str, Any]]
    ) -> None:
        self._resolved, self._folder, self._components = resolved, folder, components

    def save(self, path: Path, *, frames: int, is_needed: bool = True) -> bool:
        """Save to ``folder.last`` or ``folder.best``, and tell whether it could be written.

        Raises:
            CheckpointNotWritten: if it ``is_needed``; else a run survives a disk that is full for
                a while.
        """
        if path == self._folder.last:  # the rows that it counts survive a power failure too
            with suppress(OSError), self._folder.metrics.open("rb") as rows:
                os.fsync(rows.fileno())
        try:
            save_checkpoint(
                path,
                self._components(),
                spec=self._resolved.spec,
                frames=frames,
                config=self._resolved.plan.to_config(),
                keep=self._resolved.plan.run.keep_checkpoints if path == self._folder.last else 1,
            )
        except CheckpointNotWritten as error:
            if is_needed:
                raise
            logger.error("%s; continuing without", error)
            return False
        return True

    def load_last(self) -> None:
        """Restore all components from the last checkpoint; see ``load_checkpoint``."""
        self._load(self._components(), which="last")

    def load_best(self, actor: Any) -> int:
        """Load the best policy, and return after how many frames it was saved."""
        return int(self._load({"actor": actor}, which="best")["frames"])

    def _load(self, components: Mapping[str, Any], *, which: str) -> dict[str, Any]:
        return load_checkpoint(
            self._folder.path,
            components,
            spec=self._resolved.spec,
            device=self._resolved.plan.run.policy_device,
            which=which,
        )
