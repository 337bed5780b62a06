"""The collector carries the memory of recurrent policies."""

from __future__ import annotations

from itertools import pairwise

import torch

from fishrl.training.algorithms.drqn import DRQN
from tests.training.conftest import Toy


def test_lstm_state_carries_over_between_decisions_and_resets_with_each_episode(toy: Toy) -> None:
    training = toy.begin(algorithm=DRQN(sequence_length=4), warmup_frames=0, task={"time_limit": 4})
    batches = iter(training.collector)
    seen = [next(batches)[:, 0].clone() for _ in range(9)]
    for before, after in pairwise(seen):
        begins = after["is_init"].squeeze(-1)
        memory = after["recurrent_state_h"]
        assert (memory[begins] == 0).all()
        assert torch.equal(memory[~begins], before["next", "recurrent_state_h"][~begins])
        assert (memory[~begins] != 0).any(-1).all()
