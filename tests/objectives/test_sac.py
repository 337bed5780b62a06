"""TorchRL's SAC loss for continuous actions, with the settings of the training."""

import torch
from tensordict import TensorDict

from fishrl.training.algorithms.sac import SAC
from fishrl.training.policy_spec import PolicySpec
from tests.objectives.transitions import NUM_INPUTS, make_transitions


def test_target_bootstraps_truncated_but_not_terminated_states() -> None:
    spec = PolicySpec(
        task="any", num_inputs=NUM_INPUTS, num_actions=2, is_continuous=True, hidden=(16,)
    )
    draw = torch.Generator().manual_seed(1)
    policy = SAC().make_policy(spec, draw)
    loss = SAC().make_loss(policy, spec, draw)
    loss.make_value_estimator(gamma=0.9)

    def compute_loss(data: TensorDict) -> torch.Tensor:
        torch.manual_seed(2)  # of the next actions
        value: torch.Tensor = loss(data)["loss_qvalue"]
        return value

    data = make_transitions()
    data["action"] = 2.0 * torch.rand(len(data), 2, generator=draw) - 1.0
    ended, terminated = data["next", "done"], data["next", "terminated"]
    assert (ended & ~terminated).any()

    running = data.clone()
    running["next", "done"] = terminated.clone()
    assert torch.equal(compute_loss(running), compute_loss(data))

    for rows, depends in ((ended & ~terminated, True), (terminated, False)):
        elsewhere = data.clone()
        elsewhere["next", "observation_stack"][rows.squeeze(-1)] += 1.0
        assert torch.equal(compute_loss(elsewhere), compute_loss(data)) is not depends
