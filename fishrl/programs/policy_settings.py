"""Settings of the programs that run a policy."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from pydantic import NonNegativeInt
from torchrl.envs import TransformedEnv

from fishrl.envs import AbstractTask, Flows, Recognition, make_env
from fishrl.envs.episodes import Policy
from fishrl.programs.configuration import Node
from fishrl.programs.program import TaskSettings
from fishrl.training.callback import Callback
from fishrl.training.checkpoint import Checkpoint
from fishrl.training.policies import prepare
from fishrl.training.policy_zoo import PREFIX, list_policies


class PolicySettings(TaskSettings):
    """The policy that a program runs, and its task.

    Args:
        task: the task; by default that of the run unless ``task`` or ``preset`` is given, and
            ``task.<argument>`` changes it.
        checkpoint: run folder or checkpoint of the policy.
        policy: baseline to run instead, see ``fishrl.training.baselines``, or ``zoo/<name>``.
        recognition: source of flow labels, as for training; by default that of the run.
        seed: of the starts and of random actions; 0 gives those of every run's final evaluation, 1
            those that selected its checkpoint.
        flows: how flows are computed, and how many advance together, at most one per episode.
    """

    checkpoint: str | None = None
    policy: str | None = None
    recognition: Recognition | None = None
    seed: NonNegativeInt = 0
    flows: Flows = Flows()

    def __post_init__(self) -> None:
        """Check that there is one source."""
        super().__post_init__()
        if sum(source is not None for source in self.sources.values()) != 1:
            raise ValueError(f"give exactly one of {', '.join(self.sources)}")
        if self.learned is None and "/" in str(self.policy):
            raise ValueError(f"policy = {self.policy}: no baseline; give a path as checkpoint=...")
        if self.policy in list_policies():
            raise ValueError(
                f"policy = {self.policy}: no baseline; did you mean {PREFIX}{self.policy}?"
            )

    @property
    def sources(self) -> dict[str, str | None]:
        """Return the settings of which one names the policy."""
        return {
            "checkpoint=<run folder>": self.checkpoint,
            "policy=zoo/<name> or a baseline, such as policy=random": self.policy,
        }

    @property
    def learned(self) -> str | None:
        """Where the learned policy lies, if it is no baseline."""
        is_in_zoo = self.policy is not None and self.policy.startswith(PREFIX)
        return self.policy if is_in_zoo else self.checkpoint

    @property
    def source(self) -> str | Path:
        """The policy, as ``evaluate`` takes it."""
        return str(self.policy) if self.learned is None else Path(self.learned)

    def make_policy(self) -> tuple[AbstractTask, Recognition | None, Policy]:
        """Return the task, the source of its flow labels and the policy; see ``prepare``."""
        return prepare(
            self.source,
            task=self.task,
            recognition=self.recognition,
            seed=self.seed,
            device=self.flows.device,
        )

    def make_env(
        self,
        task: AbstractTask,
        recognition: Recognition | None,
        *,
        num_envs: int,
        progress: Callback,
    ) -> TransformedEnv:
        """Return flows of ``make_policy``'s task, for whoever reads them at every check."""
        progress.on_phase("compilation" if self.flows.compile else "set-up")
        return make_env(
            task=task,
            recognition=recognition,
            flows=replace(self.flows, num_envs=num_envs),
            seed=self.seed,
            frames_per_action=task.checks_per_action,
        )


def read_task(given: Node) -> Node:
    """Return task and recognition of the ``checkpoint`` that is given.

    The task is left out where the command line, ``given``, names a task or a preset.
    """
    policy = str(given.get("policy"))
    source = policy if policy.startswith(PREFIX) else given.get("checkpoint")
    if source is None:
        return {}
    trained = Checkpoint.find(str(source)).config
    found: dict[str, Any] = {}
    if "recognition.path" not in given:
        found["recognition"] = trained.get("recognition")
    if not {"task", "preset"} & set(given):
        found |= {name: trained[name] for name in ("task", "preset") if name in trained}
    return found
