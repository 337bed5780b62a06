"""Command line and settings of a training, and those that a stored run brings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from omegaconf import MISSING
from torchrl.envs import TransformedEnv

from fishrl.bounds import bounded
from fishrl.envs import AbstractTask, make_env
from fishrl.envs.episodes import Policy
from fishrl.envs.transforms import equip
from fishrl.programs.configuration import CommandLine
from fishrl.programs.program import TaskSettings
from fishrl.training.aliases import DEFAULT_ALGORITHM, update_config
from fishrl.training.baselines import make_baseline
from fishrl.training.checkpoint import read_metadata
from fishrl.training.classifier import Recognition, find_classifier, load_recognition
from fishrl.training.description import make, to_plain
from fishrl.training.plan import LEARNING, PARTS, Plan
from fishrl.training.policies import load_policy
from fishrl.training.policy_zoo import PREFIX
from fishrl.training.progress import Progress
from fishrl.training.run_folder import RunFolder, read_config
from fishrl.training.settings import LearningSettings, RunSettings, check_device
from fishrl.viewer import ViewerSettings


@dataclass(frozen=True, kw_only=True)
class TrainConfig(LearningSettings, RunSettings, ViewerSettings):
    """Settings of a training run.

    Args:
        task: ``_target_`` and arguments of the task.
        algorithm: ``_target_`` and arguments of the algorithm (``fishrl.training.algorithms``).
        logger: ``_target_`` and arguments of the logger.
        preset: name of the preset.
        recognition: source of flow labels: ``oracle``, the file of a lateral-line classifier,
            ``zoo/<name>`` for that of a policy, or nothing.
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
        super().__post_init__()
        if self.ray_collectors and self.live:
            raise ValueError("live = true: with ray_collectors the flows are in other processes")


@dataclass(frozen=True, kw_only=True)
class PolicySettings(TaskSettings):
    """The policy that a program runs, and its task.

    Args:
        task: ``_target_`` and arguments of the task; by default that of the run unless ``task`` or
            ``preset`` is given, and ``task.<argument>`` changes it.
        checkpoint: run folder or checkpoint of the policy.
        policy: baseline to run instead, see ``fishrl.training.baselines``, or ``zoo/<name>``.
        recognition: source of flow labels, as for training; by default that of the run.
        seed: of the starts and of random actions; 0 gives those of every run's final evaluation, 1
            those that selected its checkpoint.
        device: cpu or cuda.
        compile: compile the flow solver.
    """

    checkpoint: str | None = None
    policy: str | None = None
    recognition: str | None = None
    seed: int = bounded(0, least=0)
    device: str = "cpu"
    compile: bool = True

    def __post_init__(self) -> None:
        """Check the bounds, and that there is one source."""
        super().__post_init__()
        if sum(source is not None for source in self.sources.values()) != 1:
            raise ValueError(f"give exactly one of {', '.join(self.sources)}")

    @property
    def sources(self) -> dict[str, str | None]:
        """Return the settings of which one names the policy."""
        return {
            "checkpoint=<run folder>": self.checkpoint,
            "policy=<baseline>, such as policy=random": self.policy,
        }

    @property
    def learned(self) -> str | None:
        """Where the learned policy lies, if it is no baseline."""
        is_in_zoo = self.policy is not None and self.policy.startswith(PREFIX)
        return self.policy if is_in_zoo else self.checkpoint

    def make_policy(self) -> tuple[AbstractTask, Recognition, Policy]:
        """Return the task, equipped with the source of its flow labels, and the policy."""
        check_device(self.device)
        recognition = load_recognition(self.recognition)
        task = equip(make(self.task, kind=AbstractTask), recognition)
        if self.learned is None:
            return task, recognition, make_baseline(str(self.policy), task=task, seed=self.seed)
        has_labels = recognition is not None
        policy = load_policy(self.learned, task=task, has_labels=has_labels, device=self.device)
        return task, recognition, policy

    def make_env(
        self, task: AbstractTask, recognition: Recognition, *, num_envs: int, progress: Progress
    ) -> TransformedEnv:
        """Return flows of ``make_policy``'s task, for whoever reads them at every check."""
        progress.rename("compilation" if self.compile else "set-up")
        return make_env(
            task=task,
            recognition=recognition,
            num_envs=num_envs,
            seed=self.seed,
            device=self.device,
            compile=self.compile,
            frames_per_action=task.checks_per_action,
        )


def read_resumed(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of the run that ``resume`` names, if none that is fixed is given."""
    if given.get("resume") is None:
        return {}
    folder = RunFolder.of_existing(str(given["resume"]))
    for key in given:
        if key.split(".", 1)[0] in (*PARTS, *LEARNING):
            raise ValueError(f"{key}: is fixed in {folder.path}; leave it out, or start a new run")
    return {**update_config(read_config(folder.config)), "live": False}


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
    return Plan.from_config({n: v for n, v in plain.items() if n not in ("resume", "recognition")})
