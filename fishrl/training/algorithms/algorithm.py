"""The interface of an algorithm; read this before adding one."""

import pkgutil
from abc import ABC, abstractmethod
from importlib import import_module
from inspect import isabstract
from pathlib import Path
from typing import Any, ClassVar

import torch
from tensordict.nn import TensorDictModuleBase
from torchrl.objectives import LossModule

from fishrl.envs import AbstractTask
from fishrl.settings import Settings
from fishrl.training.checkpoint import Checkpoint
from fishrl.training.learner import Learner, Networks, OffPolicyLearner
from fishrl.training.policy_spec import PolicySpec
from fishrl.training.settings import LearningSettings


class Algorithm(Settings, ABC):
    """Base of all algorithms: a frozen dataclass of the settings that only this algorithm has.

    With the class attribute ``is_traced`` the tensor operations of a gradient step are recorded
    once and replayed (``tracing.Traced``), with the same result in half the time. The loss must
    then perform the same operations at every step, without branches on the values of tensors and
    without Python numbers that change.

    The class attributes ``takes_discrete`` and ``takes_continuous`` say which actions it learns;
    by default only discrete ones. Several fish in a flow are treated as if each had a flow of its
    own, unless ``takes_several`` is false, which excludes such tasks. ``has_critic`` says that it
    has critics apart from the policy, which read ``spec.critic_keys``.
    """

    is_traced: ClassVar[bool] = False
    takes_discrete: ClassVar[bool] = True
    takes_continuous: ClassVar[bool] = False
    takes_several: ClassVar[bool] = True
    has_critic: ClassVar[bool] = False

    @property
    def label(self) -> str:
        """Part of a run folder's name; by default the name of the class in lower case."""
        return type(self).__name__.lower()

    @classmethod
    def takes(cls, task: AbstractTask) -> bool:
        """Return whether it learns the actions of a task."""
        fits = cls.takes_discrete if task.action_bounds is None else cls.takes_continuous
        return fits and (cls.takes_several or task.num_fish == 1)

    def check(self, task: AbstractTask) -> None:
        """Raise ValueError, naming the algorithms that fit, unless it learns a task's actions."""
        if not self.takes(task):
            kind = "discrete" if task.action_bounds is None else "continuous"
            kind = f"{kind} actions" + " of several fish" * (task.num_fish > 1)
            fitting = [name for name, kind in find_algorithms().items() if kind.takes(task)]
            raise ValueError(
                f"algorithm = {type(self).__name__}: does not learn the {kind} of "
                f"{type(task).__name__} with these settings; take one of {', '.join(fitting)}"
            )
        if task.critic_senses and not self.has_critic:
            names = [name for name, kind in find_algorithms().items() if kind.has_critic]
            seen = task.critic_observes
            raise ValueError(
                f"{f'task.critic_observes = {seen}' if seen else 'critic_senses'}: "
                f"{type(self).__name__} has no critic apart from its policy; take one of "
                f"{', '.join(names)}, or leave it empty"
            )

    def adapt(self, settings: LearningSettings) -> dict[str, Any]:
        """Return common settings that follow from the settings of this algorithm.

        By default none, for algorithms that begin with a warm-up; ValueError if they need one.
        """
        if settings.scale_inputs and not settings.warmup_frames:
            raise ValueError(
                "warmup_frames = 0: scale_inputs measures the scale in the warm-up; raise it"
            )
        return {}

    def count_states(self, settings: LearningSettings) -> int:
        """Return how many numbers of its own a transition holds, for the estimate of memory."""
        return 0

    @abstractmethod
    def make_policy(self, spec: PolicySpec, generator: torch.Generator | None = None) -> Any:
        """Make the policy that is evaluated and saved, greedy under ``DETERMINISTIC``.

        ``generator`` draws the initial weights.
        """

    @abstractmethod
    def make_loss(self, policy: Any, spec: PolicySpec, generator: torch.Generator) -> LossModule:
        """Make the loss that trains the policy; its other networks lie on the policy's device."""

    def make_explorer(self, policy: Any, spec: PolicySpec) -> TensorDictModuleBase:
        """Make the policy that collects, with the same weights; by default the policy itself."""
        return policy

    def assemble(self, networks: Networks, settings: LearningSettings) -> Learner:
        """Return the learner of new networks; by default it replays past transitions.

        ``DRQN`` replays sequences, and ``PPO`` learns from rollouts.
        """
        return OffPolicyLearner(networks, settings)

    def make_learner(
        self,
        spec: PolicySpec,
        settings: LearningSettings,
        *,
        device: str = "cpu",
        initial: Checkpoint | None = None,
    ) -> Learner:
        """Make a new policy and its learner; ``settings.seed`` fixes the initial weights.

        With ``initial`` the policy has the weights of one that was trained.
        """
        generator = torch.Generator().manual_seed(settings.seed)
        policy = self.make_policy(spec, generator).to(device)
        if initial is not None:
            initial.load({"actor": policy}, spec=spec, device=device)
        loss = self.make_loss(policy, spec, generator)
        explorer = self.make_explorer(policy, spec)
        networks = Networks(policy, explorer, loss, spec, is_traced=self.is_traced)
        return self.assemble(networks, settings)


def find_algorithms() -> dict[str, type[Algorithm]]:
    """Find the algorithms of this package by the names of their modules."""
    found = {}
    for each in pkgutil.iter_modules([str(Path(__file__).parent)]):
        module = import_module(f"{__package__}.{each.name}")
        for kind in vars(module).values():
            is_own = isinstance(kind, type) and kind.__module__ == module.__name__
            if is_own and issubclass(kind, Algorithm) and not isabstract(kind):
                found[each.name] = kind
    return found
