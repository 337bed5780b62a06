"""The episode runner: every start once, in any number of rows, and the env as it was afterwards."""

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import TransformedEnv

from fishrl.envs import FlowEnv, Predation, make_env
from fishrl.envs.episodes import Episodes, has_succeeded, run_episodes
from tests.envs.conftest import SMALL, keep_straight

pytestmark = pytest.mark.usefixtures("kinematic")
NUM_STARTS = 5


@pytest.fixture
def task() -> Predation:
    return Predation(**SMALL, time_limit=6)


def make(task: Predation, num_envs: int, **settings: int) -> TransformedEnv:
    return make_env(task=task, num_envs=num_envs, compile=False, **settings)


def draw(task: Predation, num: int = NUM_STARTS) -> TensorDict:
    starts = task.sample_starts(num, torch.Generator().manual_seed(3))
    starts["head"][0, 0] = 1.5 * task.body_length  # the first reaches the wall before the others
    starts["heading"] = torch.full_like(starts["heading"], torch.pi)
    return starts


def tensors(episodes: Episodes) -> list[Tensor]:
    return [value for value in vars(episodes).values() if isinstance(value, Tensor)]


@pytest.mark.parametrize("num_envs", [1, 2, 5, 7])
def test_the_outcome_of_a_start_does_not_depend_on_the_number_of_rows(
    task: Predation, num_envs: int
) -> None:
    starts = draw(task)
    alone = run_episodes(make(task, 1), keep_straight, starts)
    episodes = run_episodes(make(task, num_envs), keep_straight, starts)
    assert all(map(torch.equal, tensors(episodes), tensors(alone)))
    assert episodes.terminated.tolist()[0] and episodes.lengths[0] < episodes.lengths.max()


def test_callbacks_say_which_start_each_row_runs(task: Predation) -> None:
    env, starts = make(task, 2, frames_per_action=5), draw(task)
    begun: list[int] = []
    ran, frames = torch.zeros(NUM_STARTS), torch.zeros(NUM_STARTS)

    def begin(start_of: Tensor, state: TensorDict) -> None:
        rows = start_of >= 0
        assert torch.equal(state["start_index"][rows], start_of[rows])
        begun.extend(start_of[rows].tolist())

    def count(start_of: Tensor, step: TensorDict) -> None:
        ran[start_of[start_of >= 0]] += 1

    def count_frame(start_of: Tensor, base: FlowEnv) -> None:
        assert torch.equal(base.is_moving, start_of >= 0)
        frames[start_of[start_of >= 0]] += 1

    episodes = run_episodes(
        env, keep_straight, starts, on_begin=begin, on_step=count, on_frame=count_frame
    )
    assert sorted(begun) == list(range(NUM_STARTS))
    assert torch.equal(ran, episodes.lengths.float())
    has_ended_early = episodes.terminated
    assert torch.equal(frames[~has_ended_early], 5 * ran[~has_ended_early])
    assert (frames[has_ended_early] < 5 * ran[has_ended_early]).all()
    assert has_ended_early.any()


class AtFood(Predation):
    """Reports success before the episode has ended."""

    def report(self, now: TensorDictBase) -> dict[str, Tensor]:
        return {"captured": torch.ones(now.shape, dtype=torch.bool)}


def test_a_diverged_episode_is_no_success_whatever_its_flag_was() -> None:
    flags = torch.tensor([[True], [False], [True]])
    ends = {name: torch.zeros(3, 1, dtype=torch.bool) for name in ("terminated", "truncated")}
    diverged = torch.tensor([[True], [False], [False]])
    after = TensorDict({"on_station": flags, "diverged": diverged, **ends}, [3])
    assert has_succeeded(after, "on_station").flatten().tolist() == [False, False, True]


def test_episodes_are_left_after_max_decisions_and_count_as_no_success() -> None:
    task = AtFood(**SMALL, time_limit=6)
    episodes = run_episodes(make(task, 5), keep_straight, draw(task), max_decisions=1)
    assert episodes.lengths.tolist() == [1] * NUM_STARTS
    assert not episodes.succeeded[~episodes.terminated].any()


def test_the_env_draws_its_own_starts_afterwards_even_if_the_policy_failed(
    task: Predation,
) -> None:
    seen: list[FlowEnv] = []
    env = make_env(task=task, num_envs=7, compile=False, on_frame=seen.append)
    base = env.base_env
    run_episodes(env, keep_straight, draw(task), on_frame=lambda start_of, base: None)

    def fail(td: TensorDict) -> TensorDict:
        raise RuntimeError

    with pytest.raises(RuntimeError):
        run_episodes(env, fail, draw(task))
    assert base.starts is None and base.on_frame == seen.append and not seen
    assert not base.is_resting.any()
    assert (env.reset()["start_index"] == -1).all()


def test_starts_that_do_not_fit_the_task_are_refused(task: Predation) -> None:
    with pytest.raises(ValueError, match="head"):
        run_episodes(make(task, 2), keep_straight, draw(task).exclude("head"))
