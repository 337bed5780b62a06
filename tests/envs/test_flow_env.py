"""Rows, resets, divergence, saved states and illegal actions of the environment, without a flow."""

import logging

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.envs import step_mdp

from fishrl.envs import FlowEnv, Flows, Predation, make_env
from tests.envs.conftest import SMALL, act, make_flows, read_flows, reset_rows, starts_at
from tests.envs.small_tasks import MaskedTask

pytestmark = pytest.mark.usefixtures("kinematic")


def make_twins(task: Predation) -> tuple[FlowEnv, FlowEnv]:
    """Return two equal environments of three flows, reset."""
    twins = make_flows(task, 3, seed=2), make_flows(task, 3, seed=2)
    for env in twins:
        env.reset()
    return twins


def test_partial_reset_changes_its_rows_alone(small_task: Predation) -> None:
    env = make_flows(small_task, 3)
    env.reset()
    act(env, 0, 1, 2)
    before, start = read_flows(env), env.start.clone()
    reset_rows(env, False, True, False)
    after = read_flows(env)
    for name, old in before.items():
        assert torch.equal(after[name][[0, 2]], old[[0, 2]]), name
    assert (env.start[[0, 2]] == start[[0, 2]]).all()
    assert not torch.equal(after["position_0"][1], before["position_0"][1])
    assert after["age_0"].tolist() == [106.0, 0.0, 106.0]


def test_set_seed_repeats_random_starts(small_task: Predation) -> None:
    env = make_flows(small_task, 3, seed=1)
    first, second = (env.reset()["observation"] for _ in range(2))
    assert not torch.equal(first, second)
    env.set_seed(1)
    assert torch.equal(env.reset()["observation"], first)
    with pytest.raises(ValueError, match=r"seed = 'a': must be a valid integer"):
        env.set_seed("a")  # type: ignore[arg-type]
    env.set_seed(None)
    assert torch.equal(env.reset()["observation"], make_flows(small_task, 3).reset()["observation"])


def test_given_starts_follow_order_of_resets_and_rows(small_task: Predation) -> None:
    starts = small_task.sample_starts(5, torch.Generator().manual_seed(0))
    env = make_flows(small_task, 3, starts=starts)
    env.reset()
    env.set_seed(0)  # begins with the first again
    assert env.reset()["start_index"].tolist() == [0, 1, 2]
    assert reset_rows(env, False, True, True)["start_index"].tolist()[1:] == [3, 4]
    assert reset_rows(env, True, False, True)["start_index"].tolist()[::2] == [0, 1]
    assert (env.start["head"] == starts["head"][[0, 3, 1]]).all()
    assert act(env, 1, 1, 1)["start_index"].tolist() == [0, 3, 1]
    assert make_flows(small_task, 2).reset()["start_index"].tolist() == [-1, -1]


def test_resting_row_stands_still_and_affects_no_other(small_task: Predation) -> None:
    env, intact = make_twins(small_task)
    env.is_resting = torch.tensor([False, True, False])
    before = env.solver.body.position.clone()
    after, expected = act(env, 0, 1, 2), act(intact, 0, 1, 2)
    assert torch.equal(env.solver.body.position[1], before[1])
    assert env.solver.body.age.tolist() == [106.0, 0.0, 106.0]
    for key in ("observation", "reward", "done", "diverged"):
        assert torch.equal(after[key][[0, 2]], expected[key][[0, 2]])


def test_diverged_row_is_truncated(small_task: Predation, caplog: pytest.LogCaptureFixture) -> None:
    env, intact = make_twins(small_task)
    before = env.now.clone()
    env.solver.body.position[1] = torch.nan
    with caplog.at_level(logging.WARNING, logger="fishrl"):
        after, expected = act(env, 1, 1, 1), act(intact, 1, 1, 1)
    for key in ("diverged", "truncated", "done"):
        assert after[key].squeeze(-1).tolist() == [False, True, False]
    assert not after["terminated"].any() and after["reward"][1] == 0.0
    assert torch.equal(after["observation"][1], small_task.observe(before)[1])
    assert env.num_diverged == 1 and intact.num_diverged == 0
    assert "flows [1] diverged" in caplog.text
    for key in ("observation", "reward", "done"):
        assert torch.equal(after[key][[0, 2]], expected[key][[0, 2]])
    fresh = env.maybe_reset(step_mdp(TensorDict({"next": after}, [3])))
    assert fresh["observation"].isfinite().all()
    assert not fresh["diverged"].any() and not fresh["done"].any()
    assert not act(env, 1, 1, 1)["diverged"].any()
    assert env.num_diverged == 1


@pytest.mark.parametrize(("breaks_at", "expected"), [(2.0, [True, True]), (80.0, [False, True])])
def test_divergence_counts_only_before_the_episode_terminates(
    small_task: Predation, monkeypatch: pytest.MonkeyPatch, breaks_at: float, expected: list[bool]
) -> None:
    env = make_flows(small_task, 2, starts=starts_at((3.0, 2.5), (5.0, 2.5)))
    env.reset()
    monkeypatch.setattr(env.solver, "is_diverged", lambda: env.solver.body.age > breaks_at)
    after = act(env, 1, 1)
    assert after["diverged"].squeeze(-1).tolist() == expected
    assert after["captured"].squeeze(-1).tolist() == [not expected[0], False]


@pytest.mark.parametrize("is_given", [True, False])
def test_saved_environment_continues_exactly(small_task: Predation, is_given: bool) -> None:
    starts = small_task.sample_starts(4, torch.Generator().manual_seed(3)) if is_given else None
    env, other = (make_flows(small_task, 2, seed=seed, starts=starts) for seed in (2**63 + 9, 1))
    env.reset()
    act(env, 0, 2)
    env.solver.body.position[1] = torch.nan
    act(env, 0, 2)
    reset_rows(env, False, True)
    state = env.state_dict()
    first = act(env, 1, 0)
    for same in (other, env):  # what happens next does not change the saved state
        same.load_state_dict(state)
        assert same.num_diverged == 1
        assert (act(same, 1, 0) == first).all()
    assert (act(env, 2, 2) == act(other, 2, 2)).all()
    one, two = reset_rows(env, True, True), reset_rows(other, True, True)
    assert (one == two).all()
    assert one["start_index"].tolist() == ([3, 0] if is_given else [-1, -1])


def test_frames_are_evenly_spaced_and_change_nothing(small_task: Predation) -> None:
    ages: list[list[float]] = []
    seen = lambda env: ages.append(env.solver.body.age.tolist())  # noqa: E731
    env = make_flows(small_task, 2, frames_per_action=4, on_frame=seen)
    plain = make_flows(small_task, 2)
    env.reset()
    plain.reset()
    assert (act(env, 0, 1) == act(plain, 0, 1)).all()
    assert ages == [[26.0, 26.0], [52.0, 52.0], [80.0, 80.0], [106.0, 106.0]]


class Lazy(Predation):
    """A reward of one's own."""

    def reward(self, before: TensorDictBase, now: TensorDictBase) -> dict[str, torch.Tensor]:
        return super().reward(before, now) | {"effort": -0.5 * (now["beats"] - before["beats"])}


def test_reward_is_the_sum_of_its_reported_terms() -> None:
    env = make_flows(Lazy(**SMALL), 2, starts=starts_at((3.0, 2.5), (5.0, 2.5)))
    assert not env.reset()["reward/capture"].any()
    after = act(env, 1, 1)
    terms = [after[f"reward/{name}"] for name in ("approach", "capture", "effort")]
    assert [term[1].item() for term in terms] == pytest.approx([1.0, 0.0, -0.5])
    assert terms[1][0] == 20.0
    torch.testing.assert_close(after["reward"], terms[0] + terms[1] + terms[2])


@pytest.mark.parametrize("action", [-1, 0, 2])
def test_illegal_action_is_refused(action: int) -> None:
    env = make_flows(MaskedTask(**SMALL), 2)
    env.reset()
    act(env, 0, 1)
    with pytest.raises(ValueError, match=rf"action = {action} in row 0: legal is \[1\]"):
        act(env, action, 1)


def test_one_hot_action_and_task_class_are_refused() -> None:
    env = make_flows(MaskedTask(**SMALL), 2)
    one_hot = torch.tensor([[0, 1, 0], [0, 1, 0]])
    for action in (one_hot, one_hot[0, :2].float()):
        with pytest.raises(ValueError, match=r"integers of shape \(2,\).*OneHotAction"):
            env.step(env.reset().set("action", action))
    with pytest.raises(ValueError, match=r"must be an object, such as MaskedTask\(\.\.\.\)"):
        make_env(task=MaskedTask, flows=Flows(num_envs=1))  # type: ignore[arg-type]
