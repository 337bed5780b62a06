"""One-hot actions, which TorchRL's own scripts and losses expect by default."""

from torch import Tensor
from torchrl.data import Categorical, OneHot, TensorSpec
from torchrl.envs import EnvBase, Transform


class OneHotAction(Transform):
    """Take actions ``[B, num_actions]`` of which one entry is set, instead of indices ``[B]``.

    ``make_env(task=..., flows=..., transforms=[OneHotAction()])`` then has an action spec
    ``OneHot``, whose last dimension is the number of actions. Sampling it respects the mask. With
    several fish actions are ``[B, M, num_actions]``, under ``agents``.
    """

    def set_container(self, container: Transform | EnvBase) -> None:
        """Attach to an environment, whose action this transforms."""
        super().set_container(container)
        if self.container is not None:
            self.in_keys_inv = self.out_keys_inv = self.container.base_env.action_keys

    def _inv_apply_transform(self, action: Tensor) -> Tensor:
        if not (((action == 0) | (action == 1)).all() and (action.sum(-1) == 1).all()):
            raise ValueError("OneHotAction: one entry of each action must be 1, the others 0")
        return action.long().argmax(-1)

    def transform_input_spec(self, input_spec: TensorSpec) -> TensorSpec:
        """Replace the categorical spec of the action."""
        (key,) = self.in_keys_inv
        known = input_spec["full_action_spec"][key]
        if not isinstance(known, Categorical):
            raise ValueError(
                "OneHotAction: this task has continuous actions, which stay as they are"
            )
        num_actions = int(known.space.n)
        input_spec["full_action_spec"][key] = OneHot(
            num_actions, shape=(*known.shape, num_actions), device=known.device
        )
        return input_spec
