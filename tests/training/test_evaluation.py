"""The evaluation of a policy repeats, and its metrics are means over the starts."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import torch

from fishrl.envs import Flows
from fishrl.envs.episodes import Episodes, Policy, run_episodes
from fishrl.modules import PursuitPolicy, RandomPolicy
from fishrl.training.evaluation import fixed_starts
from tests.training.toy_fish import ToyPredation, make_toy_env


class Fixed:
    """An env with its starts."""

    def __init__(self, num_envs: int, num_starts: int, **task_arguments: float) -> None:
        task = ToyPredation(**task_arguments)  # type: ignore[arg-type]
        self.starts = fixed_starts(task, num_starts, seed=0)
        self.env = make_toy_env(task=task, flows=Flows(num_envs=num_envs), seed=5)

    def run(self, policy: Policy, **kwargs: Any) -> Episodes:
        return run_episodes(self.env, policy, self.starts, **kwargs)


def test_evaluation_repeats_even_on_an_env_that_was_used() -> None:
    evaluator, ended = Fixed(5, 12), list[int]()
    first = evaluator.run(RandomPolicy(seed=1), on_episodes=ended.append)
    again = evaluator.run(RandomPolicy(seed=1))
    other = evaluator.run(RandomPolicy(seed=2))
    assert sum(ended) == 12
    assert torch.equal(first.returns, again.returns)
    assert not torch.equal(first.returns, other.returns)
    env = evaluator.env  # it draws its own starts again
    assert (env.reset()["start_index"] == -1).all()
    starts = [fixed_starts(ToyPredation(), 6, seed=seed)["position"] for seed in (0, 0, 1)]
    assert torch.equal(starts[0], starts[1]) and not torch.equal(starts[0], starts[2])


def test_diverged_episodes_count_as_failures() -> None:
    result = Fixed(4, 40, divergence_rate=0.2).run(PursuitPolicy())
    metrics = result.metrics()
    assert metrics["diverged"] == int(result.diverged.sum()) > 0
    assert not (result.diverged & result.succeeded).any()


def test_metrics_average_over_starts_and_time_over_successes() -> None:
    result = Episodes(
        succeeded=torch.tensor([True, False, True, False]),
        returns=torch.tensor([10.0, 0.0, 20.0, -2.0]),
        lengths=torch.tensor([16, 60, 24, 6]),
        terminated=torch.tensor([True, False, True, False]),
        diverged=torch.tensor([False, False, False, True]),
        interval_T=0.5,
    )
    means = {"success_rate": 0.5, "mean_return": 7.0, "mean_length_T": 13.25}
    counts = {"episodes": 4, "diverged": 1}
    assert result.metrics() == means | counts | {"mean_time_to_success_T": 10.0}
    none = replace(result, succeeded=torch.zeros(4, dtype=torch.bool))
    assert math.isnan(none.metrics()["mean_time_to_success_T"])
