"""Calls of trainings, programs and wrappers that are refused; see ``tests/remedies.py``.

They begin in a folder of their own, with fish that glide.
"""

from collections.abc import Callable
from contextlib import closing, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch

from fishrl.envs import Flows, Predation, PredationPair, make_env
from fishrl.files import check_folder, claim, claim_file
from fishrl.modules import (
    make_actor,
    make_continuous_actor,
    make_mlp,
    make_recurrent_value_actor,
    make_twin_critics,
    make_value_actor,
)
from fishrl.objectives import FitSettings, MaskedDiscreteSACLoss, MaskedDQNLoss, split_episodes
from fishrl.programs import export, train, view
from fishrl.programs.lateral_line.collection import CollectionSettings
from fishrl.programs.score import check_name
from fishrl.programs.sweeps.jobs import plan_jobs
from fishrl.programs.sweeps.runs import read_runs
from fishrl.settings import build
from fishrl.training import (
    LearningSettings,
    Plan,
    Training,
    baseline,
    evaluate,
    load_plan,
    load_policy,
    open_run,
)
from fishrl.training.algorithms.discrete_sac import DiscreteSAC
from fishrl.training.algorithms.dqn import DQN
from fishrl.training.algorithms.sac import SAC
from fishrl.training.export import export_policy
from fishrl.viewer import find_recording, start_drawing
from fishrl.viewer.process import find_port
from fishrl.wrappers.gymnasium import FlowVectorEnv
from fishrl.wrappers.minari import find_dataset
from fishrl.wrappers.pettingzoo import FlowParallelEnv
from tests.envs.conftest import CONTINUOUS, SMALL
from tests.envs.test_transforms import FLOWS, TASK, save, untrained
from tests.objectives.test_classification import fit, make_network, make_parts
from tests.remedies import OUT
from tests.training.conftest import QUICK, limited_disk, make_toy_plan
from tests.viewer.scenes import make_scene

EAGER, SHORT = Flows(num_envs=1, compile=False), Predation(**SMALL, time_limit=2)
WORDS = [f"task.{name}={value}" for name, value in SMALL.items()]
WORDS += ["task.time_limit=2", "flows.compile=false", "periods=0.5"]
SIZES: dict[str, Any] = {"num_inputs": 4, "num_actions": 3}
PARTS = make_parts()
HUNT, PAIR = "fishrl/Predation-v0", PredationPair(**SMALL, time_limit=2)


def begin(**given: Any) -> Training:
    """Begin a short training of the point fish."""
    settings = (
        QUICK | {"folder": ".", "name": "run", "total_frames": 80, "eval_episodes": 1} | given
    )
    plan = make_toy_plan(Path(settings.pop("folder")), **settings)
    return Training(open_run(plan))


def finish() -> Path:
    """Return the folder of a finished training."""
    if not Path("run").exists():
        with closing(begin()) as training:
            training.run()
    return Path("run")


def reopen(**given: Any) -> None:
    with closing(Training(open_run(finish(), **given))) as training:
        training.run()


def begin_with(**given: Any) -> None:
    begin(name="second", initial_policy=str(finish()), **given).close()


def begin_another(**given: Any) -> None:
    finish()
    begin(gamma=0.5, **given).close()


def train_twice(end: bool) -> None:
    first = begin()
    if end:
        first.close()
    try:
        begin().close()
    finally:
        first.close()


def resume_without(name: str, delete: bool) -> None:
    """Resume a run one of whose files is damaged, or deleted."""
    damaged = finish() / name
    damaged.write_text("{")
    if delete:
        damaged.unlink()
    reopen(total_frames=96)


def write(space: bool) -> None:
    training = Training(open_run(finish(), total_frames=96))
    with closing(training), nullcontext() if space else limited_disk(2000):
        training.run()


def call(program: Any, *words: str) -> Callable[..., None]:
    """Return a call of a program with further settings."""

    def run(**given: Any) -> None:
        program.main.run(program.main.read([*words, *show(given)]))

    return run


def show(given: dict[str, Any]) -> list[str]:
    return [f"{name}={value}" for name, value in given.items()]


def hold(name: str) -> None:
    with claim_file("x"), claim_file(name):
        pass


def step_after_end(reset: bool, *, num_envs: int) -> None:
    flows = replace(EAGER, num_envs=num_envs)
    env = FlowVectorEnv(
        make_env(task=replace(SHORT, time_limit=1), flows=flows), autoreset_mode="Disabled"
    )
    keep = np.ones(num_envs, dtype=np.int64)
    env.reset()
    env.step(keep)
    if reset:
        env.reset(options={"reset_mask": np.ones(num_envs, dtype=bool)})
    env.step(keep)


def wrap(kind: Any, task: Any, **given: Any) -> Any:
    return kind(make_env(task=task, flows=EAGER), **given)


def act_in_pair(reset: bool, *, draw: bool = False) -> None:
    env = wrap(FlowParallelEnv, PAIR, render_mode="rgb_array")
    if reset:
        env.reset()
    if draw:
        env.render()
    else:
        env.step(dict.fromkeys(env.possible_agents, 1))


def step_first(reset: bool) -> None:
    env = wrap(FlowVectorEnv, SHORT)
    if reset:
        env.reset()
    env.step(np.ones(1, dtype=np.int64))


def render(**given: Any) -> None:
    env = wrap(FlowVectorEnv, SHORT, **given)
    env.reset()
    env.render()


def find(rrd: str) -> None:
    Path("x.rrd").touch()
    find_recording(rrd)


def take(folder: str) -> None:
    Path("taken").touch()
    begin(folder=folder).close()


def claim_in(folder: str) -> None:
    Path("taken").touch()
    with claim(Path(folder, "x")):
        pass


def find_again(name: str) -> None:
    Path("x-v0").mkdir(exist_ok=True)
    find_dataset(name, ".")


def read_own(**given: Any) -> None:
    Path("own_control.py").write_text(
        "from fishrl.envs.control import Turn\n\n\nclass Own(Turn): pass\n"
    )
    build(Predation, {"control": {"_target_": "own_control.Own"}}, **given)


def learn(parts: list[Any]) -> None:
    fit(make_network(), parts, settings=FitSettings(num_epochs=1))


def check_classifier(stream_speed_bl: float) -> None:
    flows = [*FLOWS[:2], FLOWS[2] | {"stream_speed_bl": stream_speed_bl}]
    save(Path(), flows=flows).check(TASK)


def split(episodes: int, shares: tuple[float, float] = (0.5, 0.5)) -> None:
    label, generator = torch.zeros(episodes, dtype=torch.int64), torch.Generator()
    split_episodes(torch.arange(episodes), label, shares=shares, generator=generator)


def make_loss(critics: int) -> None:
    MaskedDiscreteSACLoss(make_actor(**SIZES), make_twin_critics(**SIZES)[:critics], num_actions=3)


def show_critics(critic_observes: Any) -> None:
    Plan(task=Predation(critic_observes=critic_observes), algorithm=DQN())


def record(task: Any) -> Any:
    return CollectionSettings(task=task).recorded_task


VALUES, MAKERS = (make_continuous_actor, make_value_actor), (gymnasium.make, gymnasium.make_vec)
PREDATION, RANDOM = "fishrl.envs.Predation", ("policy=random", *WORDS)
RUNS: list[tuple[Any, ...]] = [
    (lambda folder: check_folder(f"{folder}/x"), "nowhere", "."),
    (lambda file: check_folder(file), ".", "x"),
    (claim_in, "taken", "free"),
    (hold, "x", "y"),
    (lambda size: begin(buffer_size=size).close(), 10**12, 1000),
    (lambda name: check_name(name, "function", SHORT), "random", "mine"),
    (lambda warmup_frames: begin(scale_inputs=True, warmup_frames=warmup_frames).close(), 0, 16),
    (lambda widths: make_mlp((4, widths)), 0, 8),
    (untrained, "features", (), ("u_x",)),
    (untrained, "num_samples", 0, 1),
    (lambda samples: untrained().read(torch.zeros(samples, 5, 2)), 3, 16),
    (check_classifier, 2.0, 1.5),
    (partial(make_recurrent_value_actor, **SIZES), "hidden", (), (8,)),
    (split, 1, 2),
    (partial(split, 9), "shares", (0.9, 0.9), (0.5, 0.5)),
    (lambda samples: learn([PARTS[0], PARTS[1][:samples]]), 0, 9),
    (lambda exclude: learn([PARTS[0] if exclude else PARTS[0] / 0, PARTS[1]]), False, True),
    (make_loss, 1, 2),
    (lambda make_value_actor: MaskedDQNLoss(make_value_actor(**SIZES)), *VALUES),
    (lambda **g: build(Plan, {"task": {"reynolds": 500.0} | g}), "_target_", OUT, PREDATION),
    (read_own, "modules", OUT, ("own_control",)),
    (partial(Plan, task=SHORT), "algorithm", SAC(), DQN()),
    (show_critics, ("place_of_the_food",), ()),
    (partial(Plan, task=SHORT, algorithm=DQN()), "critic_frames", 9, 0),
    (partial(Plan, task=SHORT, algorithm=DQN(), initial_policy="x"), "scale_inputs", True, False),
    (begin_with, "hidden", (8,), (16,)),
    (begin_with, "algorithm", DQN(), DiscreteSAC()),
    (partial(DQN, epsilon_start=0.5), "epsilon_end", 0.9, 0.5),
    (partial(LearningSettings, buffer_size=16), "batch_size", 17, 16),
    (write, False, True),
    (lambda checkpoint: load_plan(finish() / checkpoint), "nothing", "."),
    (lambda folder: export_policy(finish(), folder), "run", "new"),
    (partial(resume_without, "metrics.csv"), "delete", False, True),
    (partial(resume_without, "summary.json"), "delete", False, True),
    (begin_another, "name", "run", "other"),
    (reopen, "total_frames", OUT, 96),
    (partial(reopen, total_frames=96), "gamma", 0.5, OUT),
    (partial(reopen, total_frames=96), "name", "other", OUT),
    (lambda tasks: baseline("mine", *tasks), (), (Predation,)),
    (partial(evaluate, "random", flows=EAGER, episodes=1), "task", OUT, SHORT),
    (partial(load_policy, "zoo/predation_sharp"), "task", Predation(num_stacked=2), OUT),
    (lambda resume: open_run(finish() / resume), "nothing", "."),
    (lambda resume: open_run(finish().parent / resume), ".", "run"),
    (take, "taken", "free"),
    (train_twice, False, True),
    (lambda **g: start_drawing(make_scene(), flows={0: "x"}, **g).close(), "save", OUT, "x.rrd"),
    (find, "y.rrd", "x.rrd"),
    (lambda port: find_port(port), 65535, 9876),
    (lambda make_vec: make_vec(HUNT, num_envs=1, flows=EAGER, **SMALL), *MAKERS),
    (find_again, "x-v0", "x-v1"),
    (lambda gymnasium: wrap(FlowVectorEnv if gymnasium else FlowParallelEnv, SHORT), False, True),
    (lambda FlowParallelEnv: wrap(FlowParallelEnv, PAIR), FlowVectorEnv, FlowParallelEnv),
    (act_in_pair, False, True),
    (partial(act_in_pair, draw=True), "reset", False, True),
    (render, "render_mode", OUT, "rgb_array"),
    (partial(step_after_end, num_envs=1), "reset", False, True),
    (partial(step_after_end, num_envs=2), "reset", False, True),
    (step_first, False, True),
    (record, SHORT, TASK),
    (record, replace(TASK, control=CONTINUOUS), TASK),
    (lambda **g: plan_jobs(show(g)), "name", "x", OUT),
    (lambda folder: read_runs(finish() / folder), ".", ".."),
    (lambda folder: read_runs(finish().parent / folder), "run/checkpoints", "."),
    (lambda **g: train.main.read([f"resume={finish()}", *show(g)]), "gamma", 0.5, OUT),
    (call(view, *WORDS, "save=x.rrd"), "policy", OUT, "random"),
    (lambda policy: call(view, "save=x.rrd", *policy)(), ("recording=y.rrd",), RANDOM),
    (call(view, *WORDS, "policy=random", "save=x.gif"), "episodes", 2, 1),
    (call(view, *WORDS, "policy=random"), "save", OUT, "x.rrd"),
    (call(export, *WORDS, "policy=random", "save=x.zarr"), "signals", "true", "false"),
]
