"""Command line and settings of a training, and what may change when it continues."""

from pathlib import Path
from typing import Annotated

from pydantic import NonNegativeInt

from fishrl.envs import AbstractTask
from fishrl.programs.configuration import CommandLine, Node
from fishrl.settings import Role, list_fields, to_plain
from fishrl.training.algorithms import Algorithm
from fishrl.training.continuation import find_changes, find_summary
from fishrl.training.logger import CsvLogger
from fishrl.training.plan import LEARNING, PARTS, Plan
from fishrl.training.run_folder import RunFolder, read_config
from fishrl.training.settings import LearningSettings, RunSettings
from fishrl.viewer import ViewerSettings


class TrainConfig(ViewerSettings, RunSettings, LearningSettings):
    """Settings of a training run.

    Args:
        task: the task.
        algorithm: the learning algorithm.
        logger: writes the metrics.
        preset: name of the preset.
        recognition: source of flow labels: ``oracle``, the file of a lateral-line classifier,
            ``zoo/<name>`` for a policy's classifier, or nothing.
        resume: run folder to continue from its last checkpoint, with its own settings.
        picture_episodes: episodes of the final evaluation to record and draw; 0 for none.
        modules: modules of your own that define tasks, algorithms or loggers.
    """

    task: AbstractTask
    algorithm: Algorithm
    logger: Annotated[CsvLogger, Role.HARMLESS]
    preset: str | None = None
    recognition: str | None = None
    resume: Annotated[str | None, Role.HARMLESS] = None
    picture_episodes: Annotated[NonNegativeInt, Role.EVALUATION] = 6
    modules: Annotated[tuple[str, ...], Role.HARMLESS] = ()

    def __post_init__(self) -> None:
        """Check what concerns several fields."""
        super().__post_init__()
        if self.ray_collectors and self.live:
            raise ValueError("live = true: with ray_collectors the flows are in other processes")

    @property
    def path(self) -> Path | None:
        """The run folder, unless a free one is to be taken."""
        if self.resume is not None:
            return Path(self.resume).expanduser()
        return None if self.name is None else Path(self.folder).expanduser() / self.name

    @property
    def has_begun(self) -> bool:
        """Whether there is a run to continue."""
        return self.path is not None and RunFolder(self.path).config.is_file()


#: Settings whose change extends a finished run, or evaluates or draws it again.
LATE = {"total_frames"} | {e.name for e in list_fields(TrainConfig) if e.role is Role.EVALUATION}


def read_resumed(given: Node) -> Node:
    """Return the settings of the run that ``resume`` names, if none that is fixed is given."""
    if given.get("resume") is None:
        return {}
    folder = RunFolder.of_existing(str(given["resume"]))
    for key in given:
        if key.split(".", 1)[0] in (*PARTS, *LEARNING):
            raise ValueError(f"{key}: is fixed in {folder.path}; leave it out, or start a new run")
    return {**read_config(folder.config), "live": False}


TRAINING = CommandLine(
    name="train",
    schema=TrainConfig,
    groups={
        "task": "predation",
        "algorithm": "discrete_sac",
        "logger": "csv",
        "preset": None,
        "experiment": None,
    },
    stored=read_resumed,
)


def make_plan(config: TrainConfig) -> Plan:
    """Return the plan of a run with these settings."""
    values = {entry.name: getattr(config, entry.name) for entry in list_fields(TrainConfig)}
    learning = LearningSettings(**{name: values.pop(name) for name in LEARNING})
    run = RunSettings(**{e.name: values.pop(e.name) for e in list_fields(RunSettings)})
    parts = {name: values.pop(name) for name in PARTS}
    del parts["recognition"], values["resume"], values["modules"]
    return Plan(**parts, learning=learning, run=run, extra=to_plain(values))


def is_finished(config: TrainConfig) -> bool:
    """Tell whether the run in the folder has been trained and evaluated with these settings.

    Raises:
        ValueError: if the run has others that fix its result.
    """
    if not config.has_begun:
        return False
    plan, folder = make_plan(config), str(config.path)
    changes = find_changes(folder, plan, recognition=config.recognition)
    late = {name: value for name, value in changes.items() if name in LATE}
    return find_summary(folder, **late) is not None
