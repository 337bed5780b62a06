"""Recognition: where flow labels come from, the truth or a classifier."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self

from torchrl.envs import Transform

from fishrl.envs.extensions import HasFlowLabels, find_extension
from fishrl.envs.task import AbstractTask
from fishrl.envs.transforms import TrueFlowLabel
from fishrl.settings import Settings, describe


class Recognition(Settings, ABC):
    """Base of the sources of flow labels, for ``make_env(recognition=...)`` and trainings."""

    def check(self, task: AbstractTask) -> AbstractTask:
        """Return the task that reads the labels which ``transforms`` write.

        Raises:
            ValueError: if the task has no labelled flows, or several fish.
        """
        if not isinstance(task, HasFlowLabels) or task.num_fish > 1:
            raise ValueError(
                f"recognition: {type(task).__name__} has no flows to tell apart, or several fish; "
                "leave it out, or take a task of one fish with `flow_labels`"
            )
        return task.read_flow_labels()

    @abstractmethod
    def transforms(self, task: AbstractTask) -> Sequence[Transform]:
        """Return new transforms that write flow labels, to stand before the frame stack."""

    def keep(self, folder: Path) -> Self:
        """Copy the files that it reads into the folder of a run; return itself reading these."""
        return self

    @property
    def identity(self) -> Mapping[str, Any]:
        """Plain data that are equal for sources that give equal labels."""
        return describe(self)


class Oracle(Recognition):
    """The true flow: the upper bound for a classifier."""

    def transforms(self, task: AbstractTask) -> Sequence[Transform]:
        """Return ``TrueFlowLabel``."""
        labels = find_extension(task, HasFlowLabels)
        is_observed = labels.num_label_inputs > 0
        return [TrueFlowLabel(num_flows=len(labels.flow_labels), is_observed=is_observed)]
