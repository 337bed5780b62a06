"""Gymnasium vector environments of kinematic fish."""

import importlib
import sys

import numpy as np
import pytest
import torch
from gymnasium.error import Error, ResetNeeded
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode

from fishrl.envs import AbstractTask, Flows, Predation, make_env
from fishrl.wrappers.gymnasium import FlowVectorEnv
from tests.envs.conftest import CONTINUOUS, SMALL
from tests.envs.small_tasks import MaskedTask

pytestmark = pytest.mark.usefixtures("kinematic")
LIMIT = 3


def make(
    mode: str = "NextStep", task: AbstractTask | None = None, *, num_envs: int = 2
) -> FlowVectorEnv:
    task = task or Predation(**SMALL, time_limit=LIMIT)
    return FlowVectorEnv(
        make_env(task=task, flows=Flows(num_envs=num_envs, compile=False)), autoreset_mode=mode
    )


def keep(num: int = 2) -> np.ndarray:
    return np.ones(num, dtype=np.int64)


def test_observations_and_actions_belong_to_their_spaces() -> None:
    envs = make(num_envs=3)
    observations, infos = envs.reset(seed=1)
    assert observations.shape == (3, *envs.single_observation_space.shape)
    actions = envs.action_space.sample(mask=tuple(infos["action_mask"]))
    assert observations in envs.observation_space and actions in envs.action_space
    observations, rewards, terminations, truncations, infos = envs.step(actions)
    assert observations in envs.observation_space
    assert rewards.dtype == np.float64 and rewards.shape == (3,)
    for flags in (terminations, truncations):
        assert flags.dtype == np.bool_ and flags.shape == (3,)
    assert envs.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    for _ in range(2):
        envs.close()
    with pytest.raises(RuntimeError, match="closed"):
        envs.flows.solver.advance_(2)


def test_steps_equal_torchrl_environment() -> None:
    task = Predation(**SMALL, time_limit=LIMIT)
    rollout = make_env(task=task, flows=Flows(num_envs=2, compile=False), seed=3).rollout(
        8, lambda td: td.set("action", torch.full((2,), 2)), break_when_any_done=False
    )
    envs = make("SameStep", task)
    observations, _ = envs.reset(seed=3)
    for t in range(8):
        assert np.array_equal(observations, rollout["observation_stack"][:, t].numpy())
        observations, rewards, terminations, truncations, infos = envs.step(2 * keep())
        after = rollout["next"][:, t]
        outcome = {"reward": rewards, "terminated": terminations, "truncated": truncations}
        for name, values in outcome.items():
            assert np.array_equal(values, after[name].squeeze(-1).numpy())
        for row in (terminations | truncations).nonzero()[0]:
            assert np.array_equal(infos["final_obs"][row], after["observation_stack"][row].numpy())


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_continuous_actions_are_a_box(mode: str) -> None:
    envs = make(mode, Predation(**SMALL, time_limit=LIMIT, control=CONTINUOUS), num_envs=3)
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
    with pytest.raises(ValueError, match="action_masks: continuous actions have no mask"):
        envs.action_masks()


def test_next_step_autoreset_resets_without_advancing_the_flow() -> None:
    envs = make("NextStep")
    envs.reset(seed=0)
    for _ in range(LIMIT):
        _, _, terminations, truncations, infos = envs.step(keep())
    assert truncations.all() and not terminations.any()
    assert infos["step_count"].tolist() == [LIMIT] * 2
    assert (envs.flows.solver.body.age > 0).all()
    observations, rewards, terminations, truncations, infos = envs.step(keep())
    assert rewards.tolist() == [0.0, 0.0] and not (terminations | truncations).any()
    assert infos["step_count"].tolist() == [0, 0]
    assert (envs.flows.solver.body.age == 0).all()
    stack = observations.reshape(2, envs.flows.task.num_stacked, -1)
    assert (stack == stack[:, :1]).all()  # the first observation fills the stack


def test_row_awaiting_reset_does_not_affect_others() -> None:
    envs, intact = make("NextStep"), make("NextStep")
    for one in (envs, intact):
        one.reset(seed=0)
    envs.flows.solver.body.position[0] = torch.nan  # row 0 ends early
    _, rewards, _, truncations, infos = envs.step(keep())
    intact.step(keep())
    assert truncations.tolist() == infos["diverged"].tolist() == [True, False]
    assert rewards[0] == 0.0
    moved, after = intact.step(keep()), envs.step(np.array([99, 1]))  # 99 is ignored
    assert np.array_equal(after[0][1], moved[0][1]) and after[1][1] == moved[1][1]
    assert after[4]["step_count"].tolist() == [0, 2]
    assert envs.flows.is_resting.tolist() == [False, False]


def test_same_step_autoreset_returns_final_observation() -> None:
    envs = make("SameStep")
    envs.reset(seed=0)
    for _ in range(LIMIT - 1):
        assert "final_obs" not in envs.step(keep())[4]
    envs.flows.solver.body.position[0] = torch.nan
    observations, _, _, truncations, infos = envs.step(keep())
    assert truncations.tolist() == [True, True]
    assert infos["_final_obs"].tolist() == infos["_final_info"].tolist() == [True, True]
    assert infos["final_info"]["diverged"].tolist() == [True, False]
    assert infos["final_info"]["ending"].tolist() == ["the flow diverged", "time is over"]
    assert "ending" not in infos
    assert infos["final_info"]["step_count"].tolist() == [LIMIT, LIMIT]
    assert infos["step_count"].tolist() == [0, 0]
    assert np.isfinite(observations).all()
    assert not np.array_equal(infos["final_obs"][1], observations[1])


def test_disabled_autoreset_needs_a_reset_mask() -> None:
    envs = make("Disabled", num_envs=3)
    envs.reset(seed=0)
    envs.flows.solver.body.position[1] = torch.nan
    observations, _, _, truncations, infos = envs.step(keep(3))
    assert truncations.tolist() == infos["_ending"].tolist() == [False, True, False]
    assert infos["ending"].tolist() == [None, "the flow diverged", None]
    with pytest.raises(ValueError, match=r"rows \[1\] are over: call reset\(options="):
        envs.step(keep(3))
    fresh, infos = envs.reset(options={"reset_mask": truncations})
    assert infos["step_count"].tolist() == [1, 0, 1]
    assert np.array_equal(fresh[[0, 2]], observations[[0, 2]])
    assert not np.array_equal(fresh[1], observations[1])
    assert envs.step(keep(3))[4]["step_count"].tolist() == [2, 1, 2]


def test_infos_hold_masks_and_reports() -> None:
    envs = make(task=MaskedTask(**SMALL, time_limit=8))
    _, infos = envs.reset(seed=0)
    assert infos["beats"].tolist() == [1.0, 1.0]
    reported = {name for name in infos if not name.startswith("_")}
    assert {"action_mask", "diverged", "start_index", "step_count", "episode_reward"} <= reported
    assert not {"observation", "observation_stack"} & reported
    assert all(infos[f"_{name}"].tolist() == [True, True] for name in reported)
    while envs.action_masks()[:, 1].all():
        infos = envs.step(keep())[4]
        assert np.array_equal(infos["action_mask"].astype(bool), envs.action_masks())
        assert infos["action_mask"].dtype == np.int8
    with pytest.raises(ValueError, match="legal is"):
        envs.step(keep())


def test_invalid_arguments_are_refused() -> None:
    with pytest.raises(ValueError, match="'sometimes' is not a valid AutoresetMode"):
        make("sometimes")
    envs, mask = make(), {"reset_mask": np.array([True, False])}
    for call in (lambda: envs.step(keep()), envs.action_masks, lambda: envs.reset(options=mask)):
        with pytest.raises(ResetNeeded, match="call reset"):
            call()
    envs.reset()
    for actions in (np.ones(3, dtype=int), np.ones(2)):
        with pytest.raises(ValueError, match=r"actions of shape .*: expected \(2,\), integer"):
            envs.step(actions)
    for wrong in ({"reset_mask": np.ones(3, bool)}, {"reset_msk": mask["reset_mask"]}):
        with pytest.raises(ValueError, match=r"reset_mask of shape|options = "):
            envs.reset(options=wrong)
    with pytest.raises(Error):
        envs.reset(seed=-1)


@pytest.mark.parametrize(
    ("module", "needs", "package"),
    [
        ("vector", "gymnasium.error", "gymnasium"),
        ("pettingzoo", "pettingzoo", "pettingzoo"),
        ("stable_baselines", "stable_baselines3.common.vec_env", "stable-baselines3"),
        ("minari", "minari", "minari"),
    ],
)
def test_missing_framework_names_install_command(
    monkeypatch: pytest.MonkeyPatch, module: str, needs: str, package: str
) -> None:
    name = f"fishrl.wrappers.{module}"
    monkeypatch.setitem(sys.modules, needs, None)
    monkeypatch.delitem(sys.modules, name, raising=False)
    with pytest.raises(ImportError, match=rf"needs .*: pip install .*{package}"):
        importlib.import_module(name)
