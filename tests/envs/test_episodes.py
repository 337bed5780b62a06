"""Episodes: one per start in any number of rows, their traces, metrics, and the env afterwards."""

import math
from dataclasses import replace

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import TransformedEnv

from fishrl.envs import FlowEnv, Flows, Predation, make_env
from fishrl.envs.episodes import Episodes, has_succeeded, run_episodes
from tests.envs.conftest import SMALL, keep_straight

pytestmark = pytest.mark.usefixtures("kinematic")
NUM_STARTS = 5


@pytest.fixture
def task() -> Predation:
    return Predation(**SMALL, time_limit=6)


def make(task: Predation, num_envs: int, **settings: int) -> TransformedEnv:
    return make_env(task=task, flows=Flows(num_envs=num_envs, compile=False), **settings)


def draw(task: Predation, num: int = NUM_STARTS) -> TensorDict:
    starts = task.sample_starts(num, torch.Generator().manual_seed(3))
    starts["head"][0, 0] = 1.5 * task.body_length  # the first reaches the wall before the others
    starts["heading"] = torch.full_like(starts["heading"], torch.pi)
    return starts


def tensors(episodes: Episodes) -> list[Tensor]:
    return [value for value in vars(episodes).values() if isinstance(value, Tensor)]


@pytest.mark.parametrize("num_envs", [1, 2, 5, 7])
def test_outcome_does_not_depend_on_number_of_rows(task: Predation, num_envs: int) -> None:
    starts = draw(task)
    alone = run_episodes(make(task, 1), keep_straight, starts)
    episodes = run_episodes(make(task, num_envs), keep_straight, starts)
    assert all(map(torch.equal, tensors(episodes), tensors(alone)))
    assert episodes.terminated.tolist()[0] and episodes.lengths[0] < episodes.lengths.max()


class AtFood(Predation):
    """Reports success before the episode has ended."""

    def report(self, now: TensorDictBase) -> dict[str, Tensor]:
        return {"captured": torch.ones(now.shape, dtype=torch.bool)}


def test_diverged_episode_is_no_success() -> None:
    flags = torch.tensor([[True], [False], [True]])
    ends = {name: torch.zeros(3, 1, dtype=torch.bool) for name in ("terminated", "truncated")}
    diverged = torch.tensor([[True], [False], [False]])
    after = TensorDict({"on_station": flags, "diverged": diverged, **ends}, [3])
    assert has_succeeded(after, "on_station").flatten().tolist() == [False, False, True]


def test_episodes_cut_by_max_decisions_do_not_succeed() -> None:
    task = AtFood(**SMALL, time_limit=6)
    episodes = run_episodes(make(task, 5), keep_straight, draw(task), max_decisions=1)
    assert episodes.lengths.tolist() == [1] * NUM_STARTS
    assert not episodes.succeeded[~episodes.terminated].any()


def test_env_is_restored_even_if_the_policy_fails(task: Predation) -> None:
    seen: list[FlowEnv] = []
    env = make_env(task=task, flows=Flows(num_envs=7, compile=False), on_frame=seen.append)
    base = env.base_env
    run_episodes(env, keep_straight, draw(task), on_frame=lambda start_of, base: None)

    def fail(td: TensorDict) -> TensorDict:
        raise RuntimeError

    with pytest.raises(RuntimeError):
        run_episodes(env, fail, draw(task))
    assert base.starts is None and base.on_frame == seen.append and not seen
    assert not base.is_resting.any()
    assert (env.reset()["start_index"] == -1).all()


@pytest.mark.parametrize("num_envs", [1, 2, 7])
def test_traces_hold_each_episode_in_order(task: Predation, num_envs: int) -> None:
    env, starts = make(task, num_envs, frames_per_action=3), draw(task)
    base = env.base_env

    def read(start_of: Tensor, what: object) -> dict[str, Tensor]:
        age = base.solver.body.age
        return {"age": age, "head": base.solver.markers()[:, 0], "has_begun": age > 0.0}

    def earn(start_of: Tensor, step: TensorDict) -> dict[str, Tensor]:
        return {"reward": step["next", "reward"][:, 0]}

    episodes = run_episodes(env, keep_straight, starts, on_begin=read, on_step=earn, on_frame=read)
    traces = episodes.traces
    assert set(traces) == {"age", "head", "has_begun", "reward"}
    for e, (age, head) in enumerate(zip(traces["age"], traces["head"], strict=True)):
        assert age[0] == 0.0 and (age.diff() > 0.0).all()
        torch.testing.assert_close(head[0], starts["head"][e])
        torch.testing.assert_close(traces["reward"][e].sum(), episodes.returns[e])
    assert [len(reward) for reward in traces["reward"]] == episodes.lengths.tolist()
    padded = traces.pad("age", length=3 * task.time_limit + 1)
    assert padded.shape == (NUM_STARTS, 3 * task.time_limit + 1)
    assert torch.equal(padded.isnan(), traces.pad("has_begun", length=len(padded[0])).isnan())
    assert padded[0].isnan().any() and torch.equal(traces.of(0)["age"], traces["age"][0])


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
