"""Whether a fish is told which flow it is in, and by whom: the setting ``recognition``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from shutil import copyfile
from typing import Any

from torchrl.envs import EnvBase, Transform

from fishrl.envs import KarmanGait, TrueFlowLabel, make_recognition
from fishrl.modules import LateralLineClassifier

ORACLE = "oracle"
#: The machine that a run has copied into its folder.
OWN = "machine.pt"


class Recognition:
    """The task of a fish that is told its flow, or not, and the transforms that tell it.

    Args:
        task: as its settings make it.
        choice: None, nobody tells; ``oracle``, the truth; else the file of a lateral-line machine.
        memory: of what the machine said before; see ``fishrl.envs.PredictedFlowLabel``.

    Attributes:
        task: which takes the row of frequencies that it is told, if it is.
        is_told: whether anybody tells.
        num_told: numbers that stand behind each observation: one per flow, or none.

    Raises:
        ValueError: if the task has no flows to tell apart.
        ValueError: if the machine cannot be read, or was trained for other flows or sensors.
    """

    def __init__(self, task: Any, choice: str | None, *, memory: float = 0.7) -> None:
        self.task, self.num_told, self.is_told = task, 0, choice is not None
        self._memory = memory
        self._machine: LateralLineClassifier | None = None
        if choice is None:
            return
        if not isinstance(task, KarmanGait):
            raise ValueError(
                f"recognition={choice}: {type(task).__name__} has no flows to tell apart; "
                "take recognition=null, or task=karman_gait"
            )
        self._num_flows = len(task.flow_labels)
        self.num_told = self._num_flows if task.observes_flow else 0
        if task.control.num_flows is not None:
            self.task = replace(task, reads_flow_class=True)
        if choice != ORACLE:
            self._machine = LateralLineClassifier.load(choice)
            self._machine.check(flows=task.flow_labels, sensors=task.lateral_line_layout)

    def make_transforms(self) -> list[Transform]:
        """Return new transforms for one environment."""
        if not self.is_told:
            return []
        is_observed = self.num_told > 0
        if self._machine is None:
            return [TrueFlowLabel(num_flows=self._num_flows, is_observed=is_observed)]
        return make_recognition(self._machine, memory=self._memory, is_observed=is_observed)

    def equip(self, make_env: Callable[..., EnvBase]) -> Callable[..., EnvBase]:
        """Return a maker of environments that tell the fish."""
        if not self.is_told:
            return make_env
        return partial(make_env, transforms=self.make_transforms())


def keep_machine(choice: str | None, folder: Path) -> str | None:
    """Copy the machine of a run into its folder, where nobody trains it anew; return the setting.

    Raises:
        ValueError: if there is no such file.
    """
    if choice is None or choice == ORACLE:
        return choice
    source = Path(choice).expanduser()
    if not source.is_file():
        raise ValueError(
            f"recognition={choice}: there is no such file; give oracle, or the machine.pt that "
            "python -m experiments.train_lateral_line wrote"
        )
    copyfile(source, folder / OWN)
    return OWN


def find_machine(choice: str | None, folder: Path) -> str | None:
    """Return the setting of a run with its own machine as a path, wherever the run lies now.

    Args:
        choice: as the run's configuration has it.
        folder: of the run, or of one of its checkpoints.
    """
    if choice != OWN:
        return choice
    near = [place / OWN for place in (folder, *folder.resolve().parents[:2])]
    return str(next((path for path in near if path.is_file()), near[0]))
