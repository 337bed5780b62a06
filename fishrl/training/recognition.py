"""Recognition of flows by a lateral-line classifier, whose file a run keeps in its folder."""

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import replace
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from shutil import copyfile
from typing import Annotated, Any, Self

from pydantic import Field
from torchrl.envs import CatFrames, Transform

from fishrl.envs import AbstractTask, HasFlowLabels, PredictedFlowLabel
from fishrl.envs.extensions import find_extension
from fishrl.envs.recognition import Recognition
from fishrl.files import staged
from fishrl.modules import LateralLineClassifier
from fishrl.zoo import find_folder

#: File of a classifier in the folder of a run or a policy.
FILE = "classifier.pt"
_SIGNAL, _HISTORY = "lateral_line", "lateral_line_history"
Share = Annotated[float, Field(ge=0, le=1)]


class Classifier(Recognition):
    """Labels predicted by a ``fishrl.modules.LateralLineClassifier``; see ``PredictedFlowLabel``.

    Args:
        path: its file, as ``fishrl train-lateral-line`` writes it, or the folder of a run or policy
            that has one, such as ``zoo/gait_sharp``. A run keeps a copy.
        memory: 0 uses the current signal only, as the paper does; with 1 evidence of the episode
            never fades.
        switching_rate: probability that the flow is redrawn before a decision.
        interpolates: write the mean of the labels instead of the most probable one.
    """

    path: str
    memory: Share = 0.7
    switching_rate: Share = 0.0
    interpolates: bool = False

    @property
    def file(self) -> Path:
        """Path of the file."""
        place = find_folder(self.path)
        return place / FILE if place.is_dir() else place

    @cached_property
    def classifier(self) -> LateralLineClassifier:
        """The classifier; ValueError if the file holds none."""
        return LateralLineClassifier.load(self.file)

    def check(self, task: AbstractTask) -> AbstractTask:
        """Return the task that reads the labels.

        Raises:
            ValueError: also if the classifier was trained for other flows or sensors.
        """
        task = super().check(task)
        labels = find_extension(task, HasFlowLabels)
        self.classifier.check(flows=labels.flow_labels, sensors=labels.lateral_line_layout)
        return task

    def transforms(self, task: AbstractTask) -> Sequence[Transform]:
        """Return ``PredictedFlowLabel``, after a stack if it reads several control intervals.

        At reset the first signal fills the stack, ``lateral_line_history``.
        """
        num_intervals = self.classifier.num_intervals
        label = PredictedFlowLabel(
            classifier=deepcopy(self.classifier),
            num_flows=self.classifier.num_flows,
            memory=self.memory,
            switching_rate=self.switching_rate,
            interpolates=self.interpolates,
            in_key=_SIGNAL if num_intervals == 1 else _HISTORY,
            is_observed=find_extension(task, HasFlowLabels).num_label_inputs > 0,
        )
        if num_intervals == 1:
            return [label]
        return [CatFrames(N=num_intervals, dim=-3, in_keys=[_SIGNAL], out_keys=[_HISTORY]), label]

    def keep(self, folder: Path) -> Self:
        """Copy the file into a folder, once it is known to be a classifier."""
        assert self.classifier
        with staged(folder / FILE) as stage:
            copyfile(self.file, stage)
        return replace(self, path=str(folder / FILE))

    @property
    def identity(self) -> Mapping[str, Any]:
        """Its settings, with the file named by its content."""
        return {**super().identity, "path": name_content(self.file)}


def name_content(file: Path) -> str:
    """Return a name of a classifier that is the same for files of equal content."""
    if not file.is_file():
        return f"{file}, which is missing"
    return f"classifier {sha256(file.read_bytes()).hexdigest()[:8]}"
