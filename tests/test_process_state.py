"""Every public call leaves the process as it was; ``tests/smoke`` asks the same of each program."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import gymnasium
import pytest
import torch

import fishrl.wrappers.gymnasium  # noqa: F401
from fishrl.envs import Flows, Predation, PredationPair, make_env
from fishrl.envs.wakes import develop_wakes
from fishrl.physics import Cylinder, FlowConfig, FlowState, InPlaceSolver, estimate_memory, simulate
from fishrl.physics.fast.inductor import set_up_inductor
from fishrl.physics.flow import make_rest
from fishrl.training import LearningSettings, RunSettings, evaluate, load_policy, resume, train
from fishrl.training.export import export_policy
from fishrl.viewer import Recording, make_env_scene, record_episodes, start_drawing
from fishrl.viewer.film import write_film
from fishrl.wrappers.minari import write_dataset
from fishrl.wrappers.pettingzoo import FlowParallelEnv
from fishrl.wrappers.stable_baselines import FlowVecEnv
from tests.envs.conftest import keep_straight
from tests.envs.test_real_flow import TINY
from tests.envs.test_wakes import RECIPE
from tests.physics.flows import place_body
from tests.process_state import leaving_process_as_it_was

EAGER = Flows(num_envs=2, compile=False)
#: Actions of a few steps.
TASK = Predation(**TINY, time_limit=2, control_interval_T=0.25, checks_per_action=10)
PAIR = {"start_y_bl": (1.0, 2.0), "start_gap_bl": 0.6}
CONFIG = FlowConfig(width=40, height=32, tau=0.6, bodies=(Cylinder(diameter=8),))


def run_solver(folder: Path) -> None:
    solver = InPlaceSolver(config=CONFIG, num_envs=2, compile=False)
    solver.reset_(torch.tensor([True, False]))
    solver.command_(torch.zeros(2), 2)
    solver.advance_(2)
    solver.sample(solver.markers())
    solver.load_state_dict(solver.state_dict())
    solver.close()


def run_steps(folder: Path) -> None:
    state = FlowState(make_rest(CONFIG, 1), (place_body(20.0, 16.0),))
    estimate_memory(state, CONFIG, num_steps=2)
    simulate(state, CONFIG, num_steps=2)


def compile_nothing(folder: Path) -> None:
    with set_up_inductor(torch.device("cpu"), {}):
        pass


def develop(folder: Path) -> None:
    """The wake is too young to be taken."""
    with pytest.raises(ValueError, match="sheds too few vortices"):
        develop_wakes(replace(RECIPE, num_travels=1.0), compile=False)


def learn(folder: Path) -> None:
    few = {"log_frames": 2, "eval_frames": 2, "eval_episodes": 1, "final_episodes": 1}
    learning = LearningSettings(flows=EAGER, warmup_frames=2, batch_size=2, hidden=(8,))
    run = RunSettings(folder=str(folder), name="run", total_frames=4, baselines=(), **few)
    train(task=TASK, learning=learning, run=run)
    resume(folder / "run", total_frames=6)
    evaluate(folder / "run", episodes=1, flows=EAGER)
    load_policy(folder / "run")
    export_policy(folder / "run", folder / "policy")


def use_env(folder: Path) -> None:
    env = make_env(task=TASK, flows=EAGER)
    env.rollout(1, keep_straight)
    env.close()


def use_wrappers(folder: Path) -> None:
    for env in (
        gymnasium.make("fishrl/Predation-v0", flows=EAGER, **TINY),
        gymnasium.make_vec("fishrl/Predation-v0", num_envs=2, flows=EAGER, **TINY),
        FlowVecEnv(make_env(task=TASK, flows=EAGER)),
        FlowParallelEnv(
            make_env(task=PredationPair(**TINY | PAIR), flows=replace(EAGER, num_envs=1))
        ),
    ):
        env.reset()
        env.close()


def write_data(folder: Path) -> None:
    env = make_env(task=TASK, flows=EAGER)
    starts = TASK.sample_starts(2, torch.Generator().manual_seed(0))
    write_dataset(env, keep_straight, starts, name="state-v0", folder=folder)


def film(folder: Path) -> None:
    every = TASK.checks_per_action
    env = make_env(task=TASK, flows=replace(EAGER, num_envs=1), frames_per_action=every)
    starts, scene = TASK.sample_starts(1, torch.Generator().manual_seed(0)), make_env_scene(env)
    recording = Recording(scene=scene)
    start_drawing(scene, flows={0: ""}, save=folder / "x.rrd").close()
    record_episodes(
        env,
        keep_straight,
        starts,
        scene=scene,
        give=lambda _, frame: recording.frames.append(frame),
    )
    write_film(recording, folder / "x.gif")


@pytest.mark.parametrize(
    "call",
    [
        run_solver,
        run_steps,
        compile_nothing,
        develop,
        learn,
        use_env,
        use_wrappers,
        write_data,
        film,
    ],
)
def test_public_calls_leave_the_process_as_it_was(
    call: Callable[[Path], None], tmp_path: Path
) -> None:
    with leaving_process_as_it_was():
        call(tmp_path)
