"""Flows as a Gymnasium vector environment, on kinematic fish."""

from __future__ import annotations

import importlib
import sys
from typing import Any

import numpy as np
import pytest
import torch
from gymnasium.error import Error, ResetNeeded
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import DictInfoToList, RecordEpisodeStatistics

from fishrl.envs import AbstractTask, Predation, make_env
from fishrl.wrappers.gymnasium import FlowVectorEnv
from tests.envs.conftest import SMALL
from tests.envs.small_tasks import MaskedTask

pytestmark = pytest.mark.usefixtures("kinematic")
MODES = [mode.value for mode in AutoresetMode]
LIMIT = 3


def make(
    mode: str = "NextStep", task: AbstractTask | None = None, *, num_envs: int = 2, **options: Any
) -> FlowVectorEnv:
    task = task or Predation(**SMALL, time_limit=LIMIT)
    env = make_env(task=task, num_envs=num_envs, compile=False, **options)
    return FlowVectorEnv(env, autoreset_mode=mode)


def keep(num: int = 2) -> np.ndarray:
    return np.ones(num, dtype=np.int64)


def test_observations_and_actions_are_of_their_spaces() -> None:
    envs = make(num_envs=3)
    observations, infos = envs.reset(seed=1)
    assert observations in envs.observation_space
    assert observations.shape == (3, *envs.single_observation_space.shape)
    masks = tuple(infos["action_mask"])
    actions = envs.action_space.sample(mask=masks)
    assert actions in envs.action_space
    observations, rewards, terminations, truncations, infos = envs.step(actions)
    assert observations in envs.observation_space
    assert rewards.dtype == np.float64
    assert {a.shape for a in (rewards, terminations, truncations)} == {(3,)}
    assert terminations.dtype == truncations.dtype == np.bool_
    assert envs.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    envs.close()
    assert envs.flows.solver.is_closed
    envs.close()


def test_steps_are_those_of_the_torchrl_environment() -> None:
    task = Predation(**SMALL, time_limit=LIMIT)
    rollout = make_env(task=task, num_envs=2, seed=3, compile=False).rollout(
        8, lambda td: td.set("action", torch.full((2,), 2)), break_when_any_done=False
    )
    envs = make("SameStep", task)
    observations, _ = envs.reset(seed=3)
    # TorchRL's first reset comes a second time after the seed is set anew: same episode
    for t in range(8):
        assert np.array_equal(observations, rollout["observation_stack"][:, t].numpy())
        observations, rewards, terminations, truncations, infos = envs.step(2 * keep())
        after = rollout["next"][:, t]
        assert np.array_equal(rewards, after["reward"].squeeze(-1).double().numpy())
        assert np.array_equal(terminations, after["terminated"].squeeze(-1).numpy())
        assert np.array_equal(truncations, after["truncated"].squeeze(-1).numpy())
        for row in (terminations | truncations).nonzero()[0]:
            last = after["observation_stack"][row].numpy()
            assert np.array_equal(infos["final_obs"][row], last)


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_continuous_actions_are_numbers_in_a_box(mode: str) -> None:
    envs = make(mode, Predation(**SMALL, time_limit=LIMIT, action="continuous"), num_envs=3)
    assert envs.single_action_space == Box(-1.0, 1.0, (2,), np.float32)
    _, infos = envs.reset(seed=1)
    assert "action_mask" not in infos
    envs.action_space.seed(0)
    for _ in range(LIMIT + 2):  # beyond the end of an episode
        observations, *_ = envs.step(envs.action_space.sample())
        assert observations in envs.observation_space
    for wrong in (np.ones(3, np.float32), np.ones((3, 2), int)):
        with pytest.raises(ValueError, match=r"actions of shape .*: expected \(3, 2\), floating"):
            envs.step(wrong)
    with pytest.raises(ValueError, match="action_masks: continuous actions have none"):
        envs.action_masks()


@pytest.mark.parametrize("mode", MODES)
def test_one_seed_gives_one_course_and_another_another(mode: str) -> None:
    envs = make(mode)
    courses = []
    for seed in (5, 5, 6):
        course = [envs.reset(seed=seed)[0]]
        course += [envs.step(keep())[0] for _ in range(LIMIT)]
        courses.append(np.stack(course))
    assert np.array_equal(courses[0], courses[1])
    assert not np.array_equal(courses[0], courses[2])
    assert not np.array_equal(courses[0][0, 0], courses[0][0, 1])  # rows draw their own


def test_rows_that_end_begin_anew_in_the_next_step_and_lose_no_time() -> None:
    envs = make("NextStep")
    observations, _ = envs.reset(seed=0)
    for _ in range(LIMIT):
        _, _, terminations, truncations, infos = envs.step(keep())
    assert truncations.all() and not terminations.any()
    assert infos["step_count"].tolist() == [LIMIT] * 2
    age = envs.flows.solver.body.age.clone()
    observations, rewards, terminations, truncations, infos = envs.step(keep())
    assert rewards.tolist() == [0.0, 0.0]
    assert not (terminations | truncations).any()
    assert infos["step_count"].tolist() == [0, 0]
    assert (age > 0).all() and (envs.flows.solver.body.age == 0).all()
    stack = observations.reshape(2, envs.env.base_env.task.num_stacked, -1)
    assert (stack == stack[:, :1]).all()  # the first observation fills the stack


def test_a_row_that_waits_for_its_reset_leaves_its_neighbour_alone() -> None:
    """Row 0 is ended early by divergence; row 1 goes on as if nothing were."""
    envs, intact = make("NextStep"), make("NextStep")
    for one in (envs, intact):
        one.reset(seed=0)
    envs.flows.solver.body.position[0] = torch.nan
    _, rewards, _, truncations, infos = envs.step(keep())
    intact.step(keep())
    assert truncations.tolist() == infos["diverged"].tolist() == [True, False]
    assert rewards[0] == 0.0
    moved = intact.step(keep())
    # an illegal or absurd action of a row that waits is ignored
    after = envs.step(np.array([99, 1]))
    assert np.array_equal(after[0][1], moved[0][1])
    assert after[1][1] == moved[1][1]
    assert after[4]["step_count"].tolist() == [0, 2]
    assert envs.flows.is_resting.tolist() == [False, False]


def test_rows_that_end_begin_anew_in_the_same_step_and_show_their_end() -> None:
    envs = make("SameStep")
    envs.reset(seed=0)
    for _ in range(LIMIT - 1):
        infos = envs.step(keep())[4]
        assert "final_obs" not in infos
    envs.flows.solver.body.position[0] = torch.nan
    observations, _, _, truncations, infos = envs.step(keep())
    assert truncations.tolist() == [True, True]
    assert infos["_final_obs"].tolist() == infos["_final_info"].tolist() == [True, True]
    assert infos["final_info"]["diverged"].tolist() == [True, False]
    assert infos["final_info"]["step_count"].tolist() == [LIMIT, LIMIT]
    assert infos["step_count"].tolist() == [0, 0]
    assert np.isfinite(observations).all()
    assert not np.array_equal(infos["final_obs"][1], observations[1])


def test_without_autoreset_rows_are_reset_by_a_mask_and_not_forgotten() -> None:
    envs = make("Disabled", num_envs=3)
    envs.reset(seed=0)
    envs.flows.solver.body.position[1] = torch.nan
    observations, _, _, truncations, _ = envs.step(keep(3))
    assert truncations.tolist() == [False, True, False]
    with pytest.raises(ValueError, match=r"rows \[1\] are over: call reset\(options="):
        envs.step(keep(3))
    fresh, infos = envs.reset(options={"reset_mask": truncations})
    assert infos["step_count"].tolist() == [1, 0, 1]
    assert np.array_equal(fresh[[0, 2]], observations[[0, 2]])
    assert not np.array_equal(fresh[1], observations[1])
    assert envs.step(keep(3))[4]["step_count"].tolist() == [2, 1, 2]


def test_masks_are_in_the_infos_and_illegal_actions_are_refused() -> None:
    envs = make(task=MaskedTask(**SMALL, time_limit=8), num_envs=2)
    _, infos = envs.reset(seed=0)
    some_illegal = False
    rng = np.random.default_rng(0)
    for _ in range(20):
        masks = envs.action_masks()
        assert np.array_equal(infos["action_mask"].astype(bool), masks)
        assert infos["action_mask"].dtype == np.int8
        some_illegal |= not masks.all()
        infos = envs.step(np.array([rng.choice(mask.nonzero()[0]) for mask in masks]))[4]
    assert some_illegal
    while envs.action_masks()[:, 1].all():
        envs.step(keep())
    with pytest.raises(ValueError, match="legal is"):
        envs.step(keep())


def test_what_a_task_reports_is_in_the_infos() -> None:
    envs = make("SameStep", MaskedTask(**SMALL, time_limit=2))
    _, infos = envs.reset(seed=0)
    assert infos["beats"].tolist() == [1.0, 1.0]
    reported = {name for name in infos if not name.startswith("_")}
    assert {"action_mask", "diverged", "start_index", "step_count", "episode_reward"} <= reported
    assert not {"observation", "observation_stack"} & reported
    assert all(infos[f"_{name}"].tolist() == [True, True] for name in reported)


def test_wrappers_of_gymnasium_fit() -> None:
    envs = RecordEpisodeStatistics(make("SameStep"))
    envs.reset(seed=0)
    rewards = sum(envs.step(keep())[1] for _ in range(LIMIT - 1))
    _, last, _, _, infos = envs.step(keep())
    assert infos["episode"]["l"].tolist() == [LIMIT, LIMIT]
    assert infos["episode"]["r"].tolist() == (rewards + last).tolist()
    rows = DictInfoToList(make())
    _, infos = rows.reset(seed=0)
    assert [info["step_count"] for info in infos] == [0, 0]


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(ValueError, match="'sometimes' is not a valid AutoresetMode"):
        make("sometimes")
    envs = make()
    for call in (lambda: envs.step(keep()), envs.action_masks):
        with pytest.raises(ResetNeeded, match="call reset"):
            call()
    with pytest.raises(ResetNeeded, match="call reset"):
        envs.reset(options={"reset_mask": np.array([True, False])})
    envs.reset()
    for actions in (np.ones(3, dtype=int), np.ones(2)):
        with pytest.raises(ValueError, match=r"actions of shape .*: expected \(2,\), integer"):
            envs.step(actions)
    with pytest.raises(ValueError, match="reset_mask of shape"):
        envs.reset(options={"reset_mask": np.ones(3, bool)})
    with pytest.raises(ValueError, match="options = "):
        envs.reset(options={"reset_msk": np.ones(2, bool)})
    with pytest.raises(Error):
        envs.reset(seed=-1)


@pytest.mark.parametrize(
    ("module", "needs", "extra"),
    [
        ("gymnasium", "gymnasium.error", "gymnasium"),
        ("stable_baselines", "stable_baselines3.common.vec_env", "stable-baselines3"),
    ],
)
def test_a_missing_framework_is_an_error_with_the_command_to_install_it(
    monkeypatch: pytest.MonkeyPatch, module: str, needs: str, extra: str
) -> None:
    name = f"fishrl.wrappers.{module}"
    monkeypatch.setitem(sys.modules, needs, None)
    monkeypatch.delitem(sys.modules, name, raising=False)
    with pytest.raises(ImportError, match=rf"needs .*: pip install .*{extra}"):
        importlib.import_module(name)
