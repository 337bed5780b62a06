"""What is counted of followers and of fish alone."""

import pytest
import torch

from experiments.following import Record, average, check_tasks, main, summarise, tabulate
from fishrl.envs import Follower
from fishrl.training.description import make


def test_work_per_distance_is_counted_from_when_the_fish_has_settled_to_its_end() -> None:
    task = Follower(time_limit=40)
    time_T = task.interval_T * torch.arange(1.0, 41.0, dtype=torch.float64)
    way = (0.5 * time_T).repeat(2, 1)
    work = torch.stack((0.2 * way[0], 0.2 * way[1]))
    work[:, 20:] += 1.0  # the first 10 T, which do not count, are dear
    rows = torch.full((2, 40), 1.0, dtype=torch.float64)
    lengths = torch.tensor([40, 10])  # the second one fails before it has settled
    for series in (way, work, rows):
        series[1, 10:] = torch.nan
    done = Record(
        place=torch.stack((1.5 * rows, -0.2 * rows), -1),
        work=work,
        way=way,
        frequency=rows,
        lengths=lengths,
        survived=torch.tensor([True, False]),
        contact=torch.tensor([False, True]),
        diverged=torch.tensor([False, False]),
        outlines=[torch.zeros(3, 2)],
        vorticity=torch.zeros(2, 2),
    )
    result = summarise(done, task, settle_T=10.0)
    assert abs(result["cost"][0] - 0.2) < 1e-12
    assert result["cost"][1] != result["cost"][1]  # NaN
    assert result["survived"] == [1.0, 0.0] and result["contact"] == [0.0, 1.0]
    assert (result["x"][0], result["aside"][0]) == (1.5, 0.2)
    table = tabulate({"a": result}, cost_alone=0.4, baseline="passive")
    row = table.splitlines()[-1]
    assert "50%" in row and "0.50" in row and "relative to passive alone" in table
    means = average([result, {**result, "cost": [0.4, 0.4]}])
    assert abs(means["cost"][0] - 0.2) < 1e-12 and means["cost"][1] == 0.4


def test_policies_swim_in_the_task_of_their_training() -> None:
    policy, small = "zoo/follower_small", ("preset=follower_small", "task.time_limit=9")
    check_tasks([policy], make(main.read([*small, "task.leader=none"]).task, kind=Follower))
    for given in ([], [*small, "task.frequency_range=[0.8,1.35]"]):
        with pytest.raises(ValueError, match="was trained in another task"):
            check_tasks([policy], make(main.read(given).task, kind=Follower))
