"""The evaluation of a policy repeats, and its metrics are means over the starts."""

import math
from dataclasses import replace

import torch

from fishrl.envs.episodes import Episodes


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
