"""Group ``train``: a gradient step, and a frame of a whole training run."""

from __future__ import annotations

import time
from typing import Any

import torch

from experiments.benchmarks.entry import FISH, OTHER, Entry, Settings, Team
from experiments.benchmarks.environment import make_task
from experiments.benchmarks.flows import CODE, describe_size
from experiments.config import load_config
from experiments.settings import TrainConfig
from fishrl.envs import make_env
from fishrl.training.algorithms import build_algorithm
from fishrl.training.checkpoint import BrainOf
from fishrl.training.collector import ResumableCollector
from fishrl.training.learner import one_thread


class Loop:
    """The training loop's collecting and learning, without its files.

    Args:
        config: settings of the run.
        task: what its fish learns.
    """

    def __init__(self, *, config: TrainConfig, task: Any) -> None:
        self.config, self.task = config, task
        brain = BrainOf.task_of(self.task)
        algorithm = build_algorithm({"algorithm": config.algorithm})
        self.learner = algorithm.make_learner(brain, config)
        self.env = make_env(
            task=self.task, num_envs=config.num_envs, seed=0, compile=config.compile
        )
        self._batches = iter(
            ResumableCollector(
                self.env,
                self.learner.explorer,
                frames_per_batch=config.num_envs,
                total_frames=-1,
                init_random_frames=config.warmup_frames,
            )
        )
        while len(self.learner.buffer) < config.batch_size:
            self.collect()

    def collect(self) -> None:
        """Take a batch of frames and remember it."""
        self.learner.remember(next(self._batches).reshape(-1))

    def learn(self, num_steps: int) -> None:
        """Take gradient steps."""
        with one_thread():
            for _ in range(num_steps):
                self.learner.update()

    def run(self, num_batches: int) -> dict[str, float]:
        """Collect a frame of every flow, learn from it, and return the share of learning."""
        learning = 0.0
        start = time.perf_counter()
        for _ in range(num_batches):
            self.collect()
            before = time.perf_counter()
            self.learn(round(self.config.updates_per_frame * self.config.num_envs))
            learning += time.perf_counter() - before
        return {"share_learning": learning / (time.perf_counter() - start)}


def make_loop(*, body_length: int, threads: int, compile: bool, num_envs: int) -> list[Entry]:
    """Make a training run, and time what it does over and over."""
    torch.set_num_threads(threads)
    overrides = [f"num_envs={num_envs}", f"compile={str(compile).lower()}"]
    config = load_config("train", ["preset=small", *overrides])
    loop = Loop(config=config, task=make_task(body_length))
    flow, substeps = loop.env.base_env.solver.config, loop.task.n_substeps
    updates = round(config.updates_per_frame * num_envs)
    return [
        Entry(
            label="train/gradient",
            name=f"gradient step, {config.batch_size} transitions",
            scope=OTHER,
            advance=loop.learn,
            unit="gradient step",
        ),
        Entry(
            label="train/frame",
            name=f"{describe_size(flow, num_envs)}, frame of all flows, {updates} gradient steps",
            scope=FISH,
            advance=loop.run,
            num_nodes=num_envs * flow.width * flow.height * substeps,
            num_steps=1,
            unit="frame of all flows",
            facts={"updates": updates, "num_envs": num_envs},
        ),
    ]


def list_teams(settings: Settings) -> list[Team]:
    """Return the process of the training loop, at the preset's number of flows."""
    arguments = {
        "body_length": settings.body_length // 2,
        "threads": settings.threads,
        "compile": True,
        "num_envs": load_config("train", ["preset=small"]).num_envs,
    }
    return [Team(code=CODE, group="train", make=make_loop, arguments=arguments)]
