"""Command line and settings of a training, and those that a stored run brings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from omegaconf import MISSING

from experiments.configuration import CommandLine
from fishrl.bounds import bounded
from fishrl.envs import AbstractTask
from fishrl.training.algorithms import Algorithm
from fishrl.training.aliases import FORMER_SETTINGS
from fishrl.training.checkpoint import read_metadata
from fishrl.training.classifier import find_classifier
from fishrl.training.description import make, to_plain
from fishrl.training.logger import CsvLogger
from fishrl.training.plan import LEARNING, PARTS, RUN, Plan
from fishrl.training.policy_zoo import PREFIX
from fishrl.training.run_folder import RunFolder, read_config
from fishrl.training.settings import LearningSettings, RunSettings
from fishrl.viewer import ViewerSettings

#: Of stored runs that name none.
DEFAULT_ALGORITHM = {"_target_": "fishrl.training.algorithms.discrete_sac.DiscreteSAC"}


@dataclass(frozen=True, kw_only=True)
class TrainConfig(LearningSettings, RunSettings, ViewerSettings):
    """Settings of a training run.

    Args:
        task: ``_target_`` and arguments of the task.
        algorithm: ``_target_`` and arguments of the algorithm (``fishrl.training.algorithms``).
        logger: ``_target_`` and arguments of the logger.
        preset: name of the preset.
        recognition: source of flow labels: ``oracle``, the file of a lateral-line classifier, or
            nothing.
        resume: run folder to continue from its last checkpoint.
        picture_episodes: episodes of the final evaluation to record and draw; 0 for none.
    """

    task: Any = MISSING
    algorithm: Any = field(default_factory=DEFAULT_ALGORITHM.copy)
    logger: Any = MISSING
    preset: str | None = None
    recognition: str | None = None
    resume: str | None = None
    picture_episodes: int = bounded(6, least=0)

    def __post_init__(self) -> None:
        """Check the bounds of all."""
        for settings in (LearningSettings, RunSettings, ViewerSettings):
            settings.__post_init__(self)
        if self.ray_collectors and self.live:
            raise ValueError("live = true: with ray_collectors the flows are in other processes")


@dataclass(frozen=True, kw_only=True)
class PolicySettings(ViewerSettings):
    """Settings of a program that runs a policy.

    Args:
        task: ``_target_`` and arguments of the task; a run brings its own unless ``task`` or
            ``preset`` is given, and ``task.<argument>`` changes it.
        preset: name of the preset.
        checkpoint: run folder or checkpoint of the policy.
        policy: baseline to run instead, see ``fishrl.training.baselines``, or ``zoo/<name>``.
        recognition: as for training; a run brings its own.
        episodes: fixed starts, one episode each.
        seed: of the starts and of random actions; 0 gives those of every run's final evaluation, 1
            those that selected its checkpoint.
        device: cpu or cuda.
        compile: compile the flow solver.
    """

    task: Any = MISSING
    preset: str | None = None
    checkpoint: str | None = None
    policy: str | None = None
    recognition: str | None = None
    episodes: int = bounded(32, least=1)
    seed: int = 0
    device: str = "cpu"
    compile: bool = True

    @property
    def learned(self) -> str | None:
        """Where the learned policy lies, if it is no baseline."""
        is_in_zoo = self.policy is not None and self.policy.startswith(PREFIX)
        return self.policy if is_in_zoo else self.checkpoint


def read_resumed(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of the run that ``resume`` names, if none that is fixed is given."""
    if given.get("resume") is None:
        return {}
    folder = RunFolder.of_existing(str(given["resume"]))
    for key in given:
        if key.split(".", 1)[0] in (*PARTS, *LEARNING):
            raise ValueError(f"{key}: is fixed in {folder.path}; leave it out, or start a new run")
    stored = read_config(folder.config)
    algorithm = {**(stored.get("algorithm") or DEFAULT_ALGORITHM)}
    algorithm |= {name: stored.pop(name) for name in FORMER_SETTINGS if name in stored}
    return {**stored, "algorithm": algorithm, "live": False}


def read_task(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return task and recognition of the ``run`` or ``checkpoint`` that is given.

    The task is left out where the command line, ``given``, names a task or a preset.
    """
    policy = str(given.get("policy"))
    source = given.get("run") or given.get("checkpoint")
    source = policy if policy.startswith(PREFIX) else source
    if source is None:
        return {}
    path, metadata = read_metadata(str(source))
    trained = metadata["config"]
    found = {"recognition": find_classifier(trained.get("recognition"), path)}
    if not {"task", "preset"} & set(given):
        found |= {"task": trained["task"], "preset": trained["preset"]}
    return found


TRAINING = CommandLine(
    schema=TrainConfig,
    groups={"task": "predation", "algorithm": "discrete_sac", "preset": None, "logger": "csv"},
    is_training=True,
    stored=read_resumed,
)


def make_plan(config: TrainConfig) -> Plan:
    """Return the plan of a run with these settings."""
    plain = to_plain(asdict(config))
    return Plan(
        task=make(config.task, kind=AbstractTask),
        algorithm=make(config.algorithm, kind=Algorithm),
        logger=make(config.logger, kind=CsvLogger),
        learning=LearningSettings(**{name: plain[name] for name in LEARNING}),
        run=RunSettings(**{name: plain[name] for name in RUN}),
        preset=config.preset,
        extra={n: v for n, v in plain.items() if n not in (*LEARNING, *RUN, *PARTS, "resume")},
    )
