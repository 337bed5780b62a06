"""The command line of a training, which sweeps and searches share."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from experiments.configuration import CommandLine, build, to_plain
from experiments.settings import DEFAULT_ALGORITHM, TrainConfig
from fishrl.training.aliases import update_names
from fishrl.training.plan import LEARNING, PARTS, RUN, Plan
from fishrl.training.run_folder import RunFolder, read_config
from fishrl.training.runs import make_folder
from fishrl.training.settings import LearningSettings, RunSettings


def read_resumed(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of the run that ``resume`` names.

    Args:
        given: settings of the command line.

    Raises:
        ValueError: if there is no such run, or a setting is fixed in it.
    """
    if given.get("resume") is None:
        return {}
    folder = RunFolder.of_existing(str(given["resume"]))
    for key in given:
        if key.split(".", 1)[0] in (*PARTS, *LEARNING):
            raise ValueError(f"{key}: is fixed in {folder.path}; leave it out, or start a new run")
    stored = read_config(folder.config)
    former = ("alpha_init", "target_entropy_weight")  # of runs before there was a choice
    algorithm = {**(stored.get("algorithm") or DEFAULT_ALGORITHM)}
    algorithm |= {name: stored.pop(name) for name in former if name in stored}
    return update_names({**stored, "algorithm": algorithm, "live": False})


TRAINING = CommandLine(
    schema=TrainConfig,
    groups={
        "task": "predation",
        "algorithm": "discrete_sac",
        "preset": None,
        "logger": "csv",
    },
    is_training=True,
    stored=read_resumed,
)


def make_plan(config: TrainConfig) -> Plan:
    """Return what a run with these settings is made from."""
    plain = to_plain(config)
    return Plan(
        task=build(config.task),
        algorithm=build(config.algorithm),
        logger=build(config.logger),
        learning=LearningSettings(**{name: plain[name] for name in LEARNING}),
        run=RunSettings(**{name: plain[name] for name in RUN}),
        preset=config.preset,
        extra={n: v for n, v in plain.items() if n not in (*LEARNING, *RUN, *PARTS, "resume")},
    )


def begin_run(config: TrainConfig, folder: RunFolder) -> RunFolder:
    """Write into a new folder all that its run needs; ``resume=<folder>`` then starts it."""
    return make_folder(make_plan(config), recognition=config.recognition, folder=folder)[0]
