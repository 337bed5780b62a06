"""Command line and settings of a training."""

from pathlib import Path
from typing import Annotated, Any

from pydantic import NonNegativeInt

from fishrl.programs.configuration import CommandLine, Node
from fishrl.settings import Role
from fishrl.training.plan import Plan, is_fixed
from fishrl.training.run_folder import RunFolder, read_config
from fishrl.viewer import ViewerSettings

#: Settings that a run takes from the command line only when it begins.
_OF_NEW_RUNS = ("experiment", "folder", "name")


class TrainConfig(ViewerSettings, Plan):
    """Settings of a training run.

    Args:
        resume: run folder to continue from its last checkpoint, with its own settings.
        picture_episodes: episodes of the final evaluation to record and draw; 0 for none.
        modules: modules of your own that define tasks, algorithms or loggers.
    """

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
        return super().path if self.resume is None else Path(self.resume).expanduser()

    def to_config(self) -> dict[str, Any]:
        """Return the settings without ``resume`` and ``modules``."""
        config = super().to_config()
        return {name: config[name] for name in config if name not in ("resume", "modules")}


def read_resumed(given: Node) -> Node:
    """Return the settings of the run that ``resume`` names; fixed ones must not be given."""
    if given.get("resume") is None:
        return {}
    folder = RunFolder.of_existing(str(given["resume"]))
    for key in given:
        if is_fixed(key) or key in _OF_NEW_RUNS:
            raise ValueError(f"{key}: is fixed in {folder.path}; leave it out, or start a new run")
    chosen = {"logger": given["logger"]} if given.get("logger") else {}
    return {**read_config(folder.config), "live": False, **chosen}


TRAINING = CommandLine(
    name="train",
    schema=TrainConfig,
    groups={
        "task": "predation",
        "algorithm": "discrete_sac",
        "logger": None,
        "preset": None,
        "experiment": None,
    },
    stored=read_resumed,
)
