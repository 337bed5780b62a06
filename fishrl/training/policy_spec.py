"""The sizes that a policy for a task must have."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fishrl.envs import AbstractTask
from fishrl.envs.extensions import HasFlowLabels, find_extension
from fishrl.envs.mirror import Mirror
from fishrl.envs.sense import count_numbers

#: Entries that a checkpoint stores and that must match.
CHECKED = ("task", "is_continuous", "num_inputs", "num_stacked", "num_actions")


def check_senses(task: AbstractTask, trained: AbstractTask, *, policy: str | Path) -> None:
    """Raise ValueError if a policy's observation is of other senses, which sizes may not tell."""
    own, stored = ([s.name for s in each.senses if s.numbers] for each in (task, trained))
    if own != stored:
        raise ValueError(
            f"senses = {own}: the policy {policy} was trained with {stored}; take those, in this "
            "order, or another policy"
        )


@dataclass(frozen=True, kw_only=True)
class PolicySpec:
    """Task and sizes of a policy; it fits no others."""

    task: str  #: name of the task's class
    num_inputs: int  #: length of the stacked observation
    num_actions: int  #: number of actions, or of the numbers in a continuous one
    num_stacked: int = 1  #: observations in a stack
    is_continuous: bool = False  #: whether actions are continuous
    num_fish: int = 1  #: fish in a flow for each of which it decides
    hidden: tuple[int, ...] = (256, 256)  #: widths of the hidden layers of all networks
    num_critic_inputs: int = 0  #: length of the stack that only critics read
    critic_num_stacked: int = 1  #: observations in it
    mirror: Mirror | None = None  #: mirror image of the task, if transitions are reflected
    critic_reads_stack: bool = True  #: whether critics read the stacked observation, too

    @property
    def sizes(self) -> dict[str, Any]:
        """Arguments of the networks."""
        return {name: getattr(self, name) for name in ("num_inputs", "num_actions", "hidden")}

    @property
    def critic_keys(self) -> tuple[str, ...]:
        """Entries that critics read."""
        own = ("critic_stack",) if self.num_critic_inputs else ()
        return ("observation_stack",) * (self.critic_reads_stack or not own) + own

    @property
    def critic_sizes(self) -> dict[str, Any]:
        """Arguments of critics."""
        keys = self.critic_keys
        lengths = {"observation_stack": self.num_inputs, "critic_stack": self.num_critic_inputs}
        return self.sizes | {"num_inputs": sum(lengths[key] for key in keys), "keys": keys}

    @property
    def stacks(self) -> dict[str, tuple[int, int]]:
        """Entries of observations: their lengths, and how many observations are stacked."""
        return {
            "observation": (self.num_observed, 1),
            "observation_stack": (self.num_inputs, self.num_stacked),
            "critic_stack": (self.num_critic_inputs, self.critic_num_stacked),
        }

    @property
    def num_observed(self) -> int:
        """Length of one observation."""
        return self.num_inputs // self.num_stacked

    @classmethod
    def for_task(
        cls,
        task: AbstractTask,
        *,
        hidden: tuple[int, ...] = (256, 256),
        has_labels: bool = False,
        reflect: bool = False,
    ) -> "PolicySpec":
        """Return the sizes that a task requires; with ``has_labels`` transforms label its flows.

        With ``reflect`` also its mirror image; ValueError if it has none.
        """
        num_labels = find_extension(task, HasFlowLabels).num_label_inputs if has_labels else 0
        return cls(
            task=type(task).__name__,
            num_inputs=(task.n_obs + num_labels) * task.num_stacked,
            num_actions=task.num_actions,
            num_stacked=task.num_stacked,
            is_continuous=task.action_bounds is not None,
            num_fish=task.num_fish,
            hidden=hidden,
            critic_num_stacked=task.critic_num_stacked,
            num_critic_inputs=task.critic_num_stacked * count_numbers(task.critic_senses),
            mirror=task.mirror if reflect else None,
            critic_reads_stack=task.critic_reads_stack,
        )

    def check(self, metadata: Mapping[str, Any], *, path: Path) -> None:
        """Raise ValueError if the metadata of a checkpoint are of another task or size."""
        for name in CHECKED:
            stored, wanted = metadata[name], getattr(self, name)
            if stored != wanted:
                raise ValueError(
                    f"checkpoint {path}: was trained with {name} = {stored!r}, the current one is "
                    f"{wanted!r}; use the task and settings of its run, or train again"
                )
