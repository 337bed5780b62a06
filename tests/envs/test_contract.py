"""What the environment and policies require of every task.

A task that appears in ``fishrl.envs.tasks`` is tested here without further ado.
"""

import dataclasses
import inspect
import pickle
from typing import Any

import pytest
import torch
from torchrl.envs import check_env_specs

import fishrl.envs.tasks
from fishrl.envs import AbstractTask, FlowEnv, make_env
from fishrl.envs.agents import split_fish
from fishrl.envs.macro_actions import ContinuousFrequency
from tests.envs.conftest import SMALL
from tests.envs.masked_task import MaskedTask

#: A tail that may beat faster needs more room before an edge.
SIZES = {
    fishrl.envs.tasks.Follower: {"checks_per_action": 30},
    fishrl.envs.tasks.KarmanGait: {"checks_per_action": 30},
}
LIBRARY = [getattr(fishrl.envs.tasks, name) for name in fishrl.envs.tasks.__all__]
pytestmark = pytest.mark.usefixtures("kinematic")


CHOICES: list[tuple[type, dict[str, Any]]] = [
    *((kind, {}) for kind in [*LIBRARY, MaskedTask]),
    (fishrl.envs.tasks.Predation, {"action": "continuous"}),
    (fishrl.envs.tasks.KarmanGait, {"control": ContinuousFrequency()}),
]


@pytest.fixture(params=CHOICES, ids=lambda choice: "-".join((choice[0].__name__, *choice[1])))
def task(request: pytest.FixtureRequest) -> AbstractTask:
    kind, settings = request.param
    return kind(**SMALL, **SIZES.get(kind, {}), **settings)


def test_every_task_of_the_package_is_listed() -> None:
    modules = fishrl.envs.tasks
    defined = {
        value
        for module in vars(modules).values()
        if inspect.ismodule(module)
        for value in vars(module).values()
        if inspect.isclass(value) and issubclass(value, AbstractTask)
        if not inspect.isabstract(value)
    }
    assert defined == set(LIBRARY)


def test_a_task_takes_keyword_arguments_with_defaults_and_never_changes(
    task: AbstractTask,
) -> None:
    parameters = inspect.signature(type(task)).parameters.values()
    assert all(p.kind is p.KEYWORD_ONLY and p.default is not p.empty for p in parameters)
    with pytest.raises(dataclasses.FrozenInstanceError):
        task.body_length = 1


def test_a_copy_has_the_settings_and_computes_what_follows_from_them_anew(
    task: AbstractTask,
) -> None:
    FlowEnv(task=task, num_envs=1, compile_flow=False).reset()  # reads wakes, draws the fish
    packed = pickle.dumps(task)
    assert len(packed) < 10_000
    copied = pickle.loads(packed)
    assert copied == task and copied.scales == task.scales


def test_the_specs_hold(task: AbstractTask) -> None:
    check_env_specs(make_env(task=task, num_envs=3, compile=False), seed=0)


def test_no_state_is_without_a_legal_action_and_random_actions_are_legal(
    task: AbstractTask,
) -> None:
    env = make_env(task=task, num_envs=4, compile=False)
    rollout = env.rollout(40, break_when_any_done=False)
    assert rollout["next", "done"].any()  # terminal states are among them
    rollout = split_fish(rollout.reshape(-1))
    if task.action_bounds is not None:
        assert rollout["action"].shape[1:] == (task.num_actions,)
        assert rollout["action"].abs().max() <= 1.0
        return
    for mask in (rollout["action_mask"], rollout["next", "action_mask"]):
        assert mask.any(-1).all()
    num_illegal = (~rollout["action_mask"].gather(-1, rollout["action"].unsqueeze(-1))).sum()
    assert num_illegal == 0


def test_starts_follow_from_random_numbers_row_by_row(task: AbstractTask) -> None:
    uniform = torch.rand(5, task.num_draws, dtype=torch.float64)
    together = task.starts_from(uniform)
    alone = torch.cat([task.starts_from(u[None]) for u in uniform])
    assert (together == alone).all()
    task.check_starts(together)
    extremes = torch.tensor([[0.0], [1.0 - 2.0**-53]], dtype=torch.float64)
    task.check_starts(task.starts_from(extremes.expand(2, task.num_draws)))


def test_no_episode_begins_at_its_end(task: AbstractTask) -> None:
    env = FlowEnv(task=task, num_envs=32, compile_flow=False)
    env.reset()
    assert not task.is_terminated(env.now).any()


def test_measuring_changes_nothing_and_shares_no_memory_with_the_flows(
    task: AbstractTask,
) -> None:
    env = FlowEnv(task=task, num_envs=2, compile_flow=False)
    env.reset()
    before = env.solver.state_dict()
    first = env.measure()
    kept = first.clone()
    assert (env.measure() == first).all()
    assert all(torch.equal(before[k], v) for k, v in env.solver.state_dict().items())
    spec = env.full_action_spec
    env.step(spec.zero() if task.action_bounds else spec.one())
    assert (first == kept).all()
