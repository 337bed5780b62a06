"""What the environment and policies require of every task.

Tasks that ``fishrl.envs.tasks`` exports are tested here without further ado.
"""

import inspect
import pickle
from typing import Any

import pytest
import torch
from torchrl.envs import check_env_specs

import fishrl.envs.tasks
from docs.task_reference import read_terms, show
from fishrl.envs import AbstractTask, Flows, make_env
from fishrl.envs.agents import TERM, split_fish
from fishrl.envs.control import ContinuousFrequency, DirectFrequencies, Turn
from fishrl.envs.episodes import name_terms
from fishrl.envs.tasks import Follower, KarmanGait, Predation, PredationPair
from tests.envs.conftest import CONTINUOUS, SMALL, make_flows
from tests.envs.small_tasks import MaskedTask

#: A tail that may beat faster needs more room before an edge.
SIZES = {kind: {"checks_per_action": 30} for kind in (Follower, KarmanGait)}
LIBRARY = [getattr(fishrl.envs.tasks, name) for name in fishrl.envs.tasks.__all__]
pytestmark = pytest.mark.usefixtures("kinematic")

CHOICES: list[tuple[type, dict[str, Any]]] = [
    *((kind, {}) for kind in [*LIBRARY, MaskedTask]),
    (Predation, {"control": CONTINUOUS}),
    (PredationPair, {"control": Turn(beat=DirectFrequencies(frequencies=(0.5, 1.0)))}),
    (KarmanGait, {"control": ContinuousFrequency()}),
]


@pytest.fixture(params=CHOICES, ids=lambda choice: "-".join((choice[0].__name__, *choice[1])))
def task(request: pytest.FixtureRequest) -> AbstractTask:
    kind, settings = request.param
    return kind(**SMALL, **SIZES.get(kind, {}), time_limit=8, **settings)


def test_package_exports_every_concrete_task() -> None:
    modules = [value for value in vars(fishrl.envs.tasks).values() if inspect.ismodule(value)]
    classes = [value for module in modules for value in vars(module).values()]
    tasks = [c for c in classes if inspect.isclass(c) and issubclass(c, AbstractTask)]
    assert {c for c in tasks if not inspect.isabstract(c)} == set(LIBRARY)


def test_pickle_holds_the_settings_alone(task: AbstractTask) -> None:
    make_flows(task, 1).reset()  # reads wakes, draws the fish
    packed = pickle.dumps(task)
    assert len(packed) < 10_000
    copied = pickle.loads(packed)
    assert copied == task and copied.scales == task.scales


def test_specs_hold(task: AbstractTask) -> None:
    check_env_specs(make_env(task=task, flows=Flows(num_envs=3, compile=False)), seed=0)


def test_reference_page_gives_every_number_action_and_term(task: AbstractTask) -> None:
    if not task.senses:
        return
    env = make_env(task=task, flows=Flows(num_envs=1, compile=False))
    assert {TERM + name for name in read_terms(type(task))} == set(name_terms(env))
    table = show(task)
    assert f"| {task.n_obs - 1} | {task.senses[-1].name} |" in table
    assert f"| {task.num_actions - 1} | {task.action_names[-1]} |" in table


def test_random_actions_are_legal_in_every_state(task: AbstractTask) -> None:
    env = make_env(task=task, flows=Flows(num_envs=4, compile=False))
    rollout = env.rollout(10, break_when_any_done=False)
    assert rollout["next", "done"].any()  # terminal states are among them
    rollout = split_fish(rollout.reshape(-1))
    if task.action_bounds is not None:
        assert rollout["action"].shape[1:] == (task.num_actions,)
        assert rollout["action"].abs().max() <= 1.0
        return
    for mask in (rollout["action_mask"], rollout["next", "action_mask"]):
        assert mask.any(-1).all()
    assert rollout["action_mask"].gather(-1, rollout["action"].unsqueeze(-1)).all()


def test_starts_follow_from_random_numbers_row_by_row(task: AbstractTask) -> None:
    uniform = torch.rand(5, task.num_draws, dtype=torch.float64)
    together = task.starts_from(uniform)
    alone = torch.cat([task.starts_from(u[None]) for u in uniform])
    assert (together == alone).all()
    task.check_starts(together)
    extremes = torch.tensor([[0.0], [1.0 - 2.0**-53]], dtype=torch.float64)
    task.check_starts(task.starts_from(extremes.expand(2, task.num_draws)))


def test_no_episode_begins_terminated(task: AbstractTask) -> None:
    env = make_flows(task, 32)
    env.reset()
    assert not task.is_terminated(env.now).any()


def test_measurement_is_a_copy_without_side_effects(task: AbstractTask) -> None:
    env = make_flows(task, 2)
    env.reset()
    before, first = env.solver.state_dict(), env.measure()
    kept = first.clone()
    assert (env.measure() == first).all()
    assert all(torch.equal(before[k], v) for k, v in env.solver.state_dict().items())
    spec = env.full_action_spec
    env.step(spec.zero() if task.action_bounds else spec.one())
    assert (first == kept).all()
