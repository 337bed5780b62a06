"""The evaluation of a policy repeats, and its metrics are means over the starts."""

import math
from dataclasses import replace

import torch

from fishrl.envs import Flows
from fishrl.envs.episodes import Episodes, run_episodes
from fishrl.modules import RandomPolicy
from fishrl.training.evaluation import fixed_starts
from tests.training.toy_fish import ToyPredation, make_toy_env


def test_evaluation_repeats_even_on_an_env_that_was_used() -> None:
    env, ended = make_toy_env(task=ToyPredation(), flows=Flows(num_envs=5), seed=5), list[int]()
    drawn = [fixed_starts(ToyPredation(), 12, seed=seed) for seed in (0, 0, 1)]
    first, again, other = (
        run_episodes(env, RandomPolicy(seed=seed), starts, on_episodes=ended.append)
        for seed, starts in zip((1, 1, 2), (drawn[0], drawn[1], drawn[0]), strict=True)
    )
    assert sum(ended) == 3 * 12
    assert torch.equal(first.returns, again.returns)
    assert not torch.equal(first.returns, other.returns)
    assert (env.reset()["start_index"] == -1).all()  # it draws its own starts again
    assert not torch.equal(drawn[0]["position"], drawn[2]["position"])


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
    for succeeded, start in (((1, 1, 1, 0), 2), ((0, 0, 1, 0), 0)):  # medians 24 and 16
        assert replace(result, succeeded=torch.tensor(succeeded).bool()).find_typical() == start
    none = replace(result, succeeded=torch.zeros(4, dtype=torch.bool))
    assert math.isnan(none.metrics()["mean_time_to_success_T"])
