"""One-hot actions, which TorchRL's own scripts and losses expect by default."""

from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Categorical, OneHot, TensorSpec
from torchrl.envs import Transform


class OneHotAction(Transform):
    """Take actions ``[B, num_actions]`` of which one entry is set, instead of indices ``[B]``.

    ``make_env(task=..., num_envs=4, transforms=[OneHotAction()])`` then has an action spec
    ``OneHot``, whose last dimension is the number of actions. Sampling it respects the mask.
    """

    def __init__(self) -> None:
        super().__init__(in_keys_inv=["action"], out_keys_inv=["action"])

    def _inv_apply_transform(self, action: Tensor) -> Tensor:
        return action.long().argmax(-1)

    def transform_input_spec(self, input_spec: TensorSpec) -> TensorSpec:
        """Replace the categorical spec of the action."""
        known = input_spec["full_action_spec", "action"]
        if not isinstance(known, Categorical):
            raise ValueError(
                "OneHotAction: this task has continuous actions, which stay as they are"
            )
        num_actions = int(known.space.n)
        input_spec["full_action_spec", "action"] = OneHot(
            num_actions, shape=(*known.shape, num_actions), device=known.device
        )
        return input_spec

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return tensordict_reset
