"""The complete settings of a run, as an object and as the ``config.yaml`` in its folder."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Self

from fishrl.envs import AbstractTask, Recognition
from fishrl.settings import TARGET, Role, build, describe, find_role, flatten, list_fields
from fishrl.training.algorithms import Algorithm
from fishrl.training.algorithms.discrete_sac import DiscreteSAC
from fishrl.training.logger import CsvLogger
from fishrl.training.recognition import FILE, Classifier
from fishrl.training.settings import LearningSettings, RunSettings


class Plan(RunSettings, LearningSettings):
    """The complete settings of a run.

    Args:
        task: the task.
        algorithm: the learning algorithm.
        logger: writes the metrics; by default the one of the run in the folder, or to a CSV file.
        preset: name of the preset.
        recognition: source of flow labels, ``Oracle()`` or ``Classifier(path=...)``.
    """

    task: AbstractTask
    algorithm: Algorithm = DiscreteSAC()
    logger: Annotated[CsvLogger | None, Role.HARMLESS] = None
    preset: str | None = None
    recognition: Recognition | None = None

    def __post_init__(self) -> None:
        """Check that the algorithm learns the actions of the task."""
        self.algorithm.check(self.task)
        super().__post_init__()
        if self.algorithm.has_critic:
            return
        kind = type(self.algorithm).__name__
        if self.critic_frames:
            raise ValueError(
                f"critic_frames = {self.critic_frames}: {kind} has no critic apart from its "
                "policy; critic_frames=0"
            )
        if self.initial_policy is not None and self.scale_inputs:
            raise ValueError(
                f"scale_inputs: with initial_policy the targets of {kind} would be of unscaled "
                "inputs; scale_inputs=false"
            )

    @property
    def folder_name(self) -> str:
        """Name of the run folder."""
        task, label = type(self.task).__name__.lower(), self.algorithm.label
        words = (task, self.preset, label, f"seed{self.seed}")
        return self.name or "-".join(word for word in words if word)

    @property
    def path(self) -> Path | None:
        """The run folder, unless a free one is to be taken."""
        return None if self.name is None else Path(self.folder).expanduser() / self.name

    @property
    def policy_device(self) -> str:
        """Device of networks and replay buffer."""
        return self.learner_device or self.flows.device

    def to_config(self) -> dict[str, Any]:
        """Return the plan as plain data; the path of a classifier is that in the run folder."""
        config = {name: value for name, value in describe(self).items() if name != TARGET}
        if isinstance(self.recognition, Classifier):
            config["recognition"] |= {"path": FILE}
        return config

    @classmethod
    def from_config(cls, config: Mapping[str, Any]) -> Self:
        """Make a plan from ``config.yaml`` or the metadata of a checkpoint; see ``to_config``.

        Missing entries keep their defaults, and those that a plan does not have are left out.
        Modules outside fishrl that it names must have been imported, since a file cannot choose
        other code; errors are those of ``settings.build``.
        """
        known = [entry.name for entry in list_fields(cls)]
        return build(cls, {name: config[name] for name in known if name in config})

    def change(self, **changes: Any) -> Self:
        """Return the plan with other settings, of those that may change once a run has begun."""
        changed = replace(self, **changes)
        for key in self.list_differences(changed):
            raise ValueError(f"{key}: is fixed in a run that has begun; start a new run")
        return changed

    def list_differences(self, other: "Plan") -> dict[str, tuple[Any, Any]]:
        """Return the settings that are fixed in a run and differ in another plan, by dotted keys.

        Each has its values in this plan and in the other, None where there is none.
        """
        one, two = (plan._flatten() for plan in (self, other))
        keys = filter(is_fixed, {**two, **one})
        values = {key: (one.get(key), two.get(key)) for key in keys}
        return {key: pair for key, pair in values.items() if pair[0] != pair[1]}

    def _flatten(self) -> dict[str, Any]:
        """Return the settings by dotted keys, a classifier by its content."""
        identity = None if self.recognition is None else self.recognition.identity
        return flatten(self.to_config() | {"recognition": identity})


def is_fixed(key: str) -> bool:
    """Return whether a setting, by its dotted key, is fixed once a run has begun."""
    is_of_plan = key.partition(".")[0] in {entry.name for entry in list_fields(Plan)}
    return is_of_plan and find_role(Plan, key) is Role.RESULT
