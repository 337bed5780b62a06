"""Benchmarks of the environment and of training.

An action lasts one tail beat, and no episode ends during a burst. ``options`` are arguments of
``make_env``.
"""

import time
from typing import Any

import torch
from torchrl.envs import ExplorationType, set_exploration_type

from experiments.benchmarks.measuring import Benchmark, BenchmarkSettings
from fishrl.envs import Flows, Predation, make_env
from fishrl.modules import make_actor
from fishrl.torch_state import one_thread
from fishrl.training import DiscreteSAC
from fishrl.training.collector import ResumableCollector
from fishrl.training.policy_spec import PolicySpec
from fishrl.training.settings import LearningSettings
from fishrl.training.tracing import EAGER_CALLS

FLOWS = Flows(num_envs=16)


def make_task(settings: BenchmarkSettings) -> Predation:
    """Return predation on one level with L / 2 and the relaxation time of L = 50 at Re = 7000."""
    length = settings.body_length // 2
    return Predation(body_length=length, levels=1, reynolds=140.0 * length)


def make_action(base: Any, label: str, what: str, advance: Any, **options: Any) -> Benchmark:
    """Return the benchmark of one action in all flows of an environment."""
    flow = base.solver.config
    name = f"{base.batch_size[0]} × {flow.width} × {flow.height}, {what}"
    return Benchmark(label=label, name=name, advance=advance, num_steps=1, **options)


def make_overhead(
    settings: BenchmarkSettings, *, task: Any = None, flows: Flows = FLOWS
) -> list[Benchmark]:
    """Return the benchmark of an action, which measures its share of time outside the flow."""
    task = task or make_task(settings)
    middle = task.starts_from(torch.full((1, task.num_draws), 0.5, dtype=torch.float64))
    env = make_env(task=task, flows=flows, seed=0, starts=middle)
    policy: Any = make_actor(
        num_inputs=task.num_stacked * task.n_obs,
        num_actions=task.num_actions,
        generator=torch.Generator().manual_seed(0),
    )
    base: Any = env.base_env
    advance_, spent, state = base.solver.advance_, [0.0], [env.reset()]  # seconds in the flow

    def prepare() -> None:
        """Begin new episodes."""
        state[0] = env.reset()

    def time_flow(*arguments: Any, **keywords: Any) -> None:
        start = time.perf_counter()
        advance_(*arguments, **keywords)
        spent[0] += time.perf_counter() - start

    def act(num_actions: int) -> dict[str, float]:
        """Step the environment with an action of the policy, as a collector does."""
        spent[0], start = 0.0, time.perf_counter()
        with torch.no_grad(), set_exploration_type(ExplorationType.RANDOM):
            _, state[0] = env.step_and_maybe_reset(policy(state[0]))
        return {"outside_flow": 1.0 - spent[0] / (time.perf_counter() - start)}

    base.solver.advance_ = time_flow
    what = "environment, transforms and policy"
    return [make_action(base, "env/policy", what, act, prepare=prepare)]


def make_training(
    settings: BenchmarkSettings, *, task: Any = None, learning: LearningSettings | None = None
) -> list[Benchmark]:
    """Return benchmarks of a gradient step, and of a frame with its gradient steps."""
    task, learning = task or make_task(settings), learning or LearningSettings(flows=FLOWS)
    learner = DiscreteSAC().make_learner(PolicySpec.for_task(task), learning)
    env = make_env(task=task, flows=learning.flows, seed=0)
    batches = iter(
        ResumableCollector(
            env, learner.explorer, frames_per_batch=learning.flows.num_envs, total_frames=-1,
            init_random_frames=learning.warmup_frames,
        )
    )  # fmt: skip
    num_updates = round(learning.updates_per_frame * learning.flows.num_envs)

    def collect() -> None:
        learner.store(next(batches).reshape(-1))

    def learn(num_steps: int) -> None:
        with one_thread():
            for _ in range(num_steps):
                learner.update()

    def run(num_batches: int) -> dict[str, float]:
        start = time.perf_counter()
        collect()
        middle = time.perf_counter()
        learn(num_updates)
        return {"learning": 1.0 - (middle - start) / (time.perf_counter() - start)}

    while len(learner.buffer) < learning.batch_size:
        collect()
    learn(EAGER_CALLS + 1)  # until steps are traced
    name = f"gradient step, {learning.batch_size} transitions"
    what = f"frame of all flows, {num_updates} gradient steps"
    gradient = Benchmark(label="train/gradient", name=name, advance=learn)
    return [gradient, make_action(env.base_env, "train/frame", what, run)]
