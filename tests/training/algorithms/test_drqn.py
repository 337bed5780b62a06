"""DRQN learns from sequences of single episodes, with a memory of its own in each."""

from itertools import pairwise

import torch

from fishrl.training.algorithms.drqn import DRQN
from tests.training.conftest import Toy

ALGORITHM = DRQN(sequence_length=4, epsilon_frames=60)


def test_sampled_sequences_do_not_cross_episodes(toy: Toy) -> None:
    learner = toy.collect(ALGORITHM, 40, task={"divergence_rate": 0.05})
    num_short = 0
    for _ in range(20):
        batch = learner.buffer.sample().reshape(-1, 4)
        is_real = batch["collector", "mask"]
        steps = batch["step_count"].squeeze(-1)
        traj = batch["collector", "traj_ids"].reshape(steps.shape)
        expected = steps[:, :1] + torch.arange(4)
        assert torch.equal(steps[is_real], expected[is_real])
        assert (traj == traj[:, :1]).all()
        begins = batch["is_init"].squeeze(-1)
        assert torch.equal(begins, steps == 0)
        num_short += int((~is_real).any(-1).sum())
        follows = batch["next", "observation"][:, :-1] == batch["observation"][:, 1:]
        assert follows[is_real[:, 1:]].all()
    assert num_short > 0


def test_lstm_state_resets_with_each_episode(toy: Toy) -> None:
    training = toy.begin(algorithm=ALGORITHM, warmup_frames=0, task={"time_limit": 4})
    batches = iter(training.collector)
    seen = [next(batches)[:, 0].clone() for _ in range(9)]
    for before, after in pairwise(seen):
        begins = after["is_init"].squeeze(-1)
        memory = after["recurrent_state_h"]
        assert (memory[begins] == 0).all()
        assert torch.equal(memory[~begins], before["next", "recurrent_state_h"][~begins])
        assert (memory[~begins] != 0).any(-1).all()
