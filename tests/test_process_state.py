"""Every public call leaves the process as it was; ``tests/smoke`` asks the same of each program."""

import cProfile
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import gymnasium
import pytest
import torch

import fishrl.wrappers.gymnasium  # noqa: F401
from fishrl import benchmark, envs, modules, objectives, physics, training, viewer
from fishrl.benchmark import (
    compare,
    find_version,
    identify,
    list_rows,
    list_versions,
    rank,
    read_row,
    show_table,
)
from fishrl.envs import Flows, Predation, PredationPair, make_env, make_task
from fishrl.envs.wakes import develop_wakes
from fishrl.modules import RandomPolicy
from fishrl.objectives import FitSettings, score_classifier
from fishrl.physics import Cylinder, FlowConfig, FlowState, InPlaceSolver, simulate
from fishrl.physics.fast.inductor import set_up_inductor
from fishrl.physics.flow import make_rest
from fishrl.training import (
    LearningSettings,
    RunSettings,
    baseline,
    evaluate,
    find_baselines,
    load_plan,
    load_policy,
    open_run,
    resume,
    train,
)
from fishrl.training.export import export_policy
from fishrl.training.run_folder import write_json
from fishrl.viewer import Recording, make_env_scene, record_episodes, start_drawing
from fishrl.viewer.film import write_film
from fishrl.wrappers.minari import write_dataset
from fishrl.wrappers.pettingzoo import FlowParallelEnv
from fishrl.wrappers.stable_baselines import FlowVecEnv
from tests.benchmark.test_rows import make_row
from tests.envs.conftest import keep_straight
from tests.envs.test_real_flow import TINY
from tests.envs.test_wakes import RECIPE
from tests.objectives.test_classification import fit, make_network, make_parts
from tests.physics.flows import place_body

ROOT = Path(__file__).parents[1]
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


def profile(folder: Path) -> None:
    """Run under a profiler of the caller's."""
    with cProfile.Profile() as profiler:
        run_solver(folder)
    seen = {getattr(entry.code, "co_name", "") for entry in profiler.getstats()}
    assert {"reset_", "load_state_dict"} <= seen


def run_steps(folder: Path) -> None:
    state = FlowState(make_rest(CONFIG, 1), (place_body(20.0, 16.0),))
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
    open_run(folder / "run")
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
    flows = viewer.name_flows(TASK, [0], starts)
    assert viewer.make_blueprint(scene, flows) and viewer.has_screen() in (True, False)
    start_drawing(scene, flows=flows, save=folder / "x.rrd").close()
    viewer.find_recording(folder / "x.rrd")
    record_episodes(
        env,
        keep_straight,
        starts,
        scene=scene,
        give=lambda _, frame: recording.frames.append(frame),
    )
    write_film(recording, folder / "x.gif")


def analyse(folder: Path) -> None:
    """Compute from signals, fields, episodes and rows."""
    wave = torch.sin(0.1 * torch.arange(500, dtype=torch.float64))
    assert physics.measure_cycles(wave, 1.0).frequency == pytest.approx(
        physics.compute_spectral_frequency(wave, 1.0), 0.01
    )
    physics.compute_strouhal(wave, 1.0, length=20.0, speed=0.1)
    physics.compute_vorticity(torch.zeros(1, 2, 8, 8))
    physics.compute_coefficient(physics.compute_pressure(torch.ones(2)), length=20.0, speed=0.1)
    physics.compute_tau(length=24.0, speed=0.1, reynolds=100.0)
    network = make_network()
    parts = make_parts()
    fit(network, parts, settings=FitSettings(num_epochs=1))
    score_classifier(network, parts[2])
    row = make_row("mine", 35.0, 5.0)
    write_json(folder / "row.json", row.model_dump())
    assert compare(make_task("quick"), TASK) and identify(make_task("station-v1"))
    assert show_table([read_row(folder / "row.json")]) and rank(list_rows("station-v1", "test"))
    assert find_version(list_versions()[0])


def look_up(folder: Path) -> None:
    """Register a baseline, and read a policy's settings."""
    baseline("still", Predation)(RandomPolicy)
    assert "still" in find_baselines(TASK) and load_plan("zoo/predation_sharp")


CALLS = (
    *(run_solver, profile, run_steps, compile_nothing, develop, learn, use_env, use_wrappers),
    *(write_data, film, analyse, look_up),
)
#: Called by others, or in need of a graphics driver.
OTHERS = {
    "complete",
    "run_episodes",
    "bang_bang",
    "open_recording",
    "write_screenshot",
}
FRESH = """
import sys
from pathlib import Path
from tests.process_state import leaving_process_as_it_was

from tests import test_process_state

for call in test_process_state.CALLS:
    with leaving_process_as_it_was():
        (folder := Path(sys.argv[1], call.__name__)).mkdir()
        call(folder)
"""


def test_public_calls_leave_a_fresh_process_as_it_was(tmp_path: Path) -> None:
    """In one that has imported nothing before, no change hides behind an earlier one."""
    command = [sys.executable, "-c", FRESH, str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert len(list(tmp_path.iterdir())) == len(CALLS)


def test_every_public_function_is_called() -> None:
    from tests.test_seeds import SEEDED  # imports all modules

    words = set(re.findall(r"\w+", Path(__file__).read_text(encoding="utf-8")))
    packages = (benchmark, envs, modules, objectives, physics, training, viewer)
    public = {name for package in packages for name in package.__all__ if name[0].islower()}
    assert len(public) > 40 and not public - words - OTHERS - SEEDED.keys()
