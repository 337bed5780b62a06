"""Group ``env``: what TorchRL adds to the flow, at one action per tail beat.

The same flows are advanced by the bare solver, by the environment, and by the environment with its
transforms, resets and a learning fish's policy. No episode ends meanwhile, so the steps are the
same.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import torch
from tensordict import TensorDictBase
from torchrl.envs import ExplorationType, set_exploration_type

from experiments.benchmarks.entry import FISH, Entry, Settings, Team
from experiments.benchmarks.flows import CODE, describe_size
from experiments.config import build, load_config
from fishrl.envs import make_env
from fishrl.modules import make_actor

NUM_ACTIONS = 5  # until the flows are reset, outside the time: no fish has reached a wall by then


def make_task(body_length: int) -> Any:
    """Return the task of preset ``small``, at its Reynolds number where L is 50."""
    overrides = [f"task.body_length={body_length}", f"task.reynolds={140.0 * body_length}"]
    return build(load_config("train", ["preset=small", *overrides]).task)


class Stage:
    """Flows, the environment around them and a policy.

    Args:
        task: what the fish has to do.
        num_envs: number of flows.
    """

    def __init__(self, *, task: Any, num_envs: int, **options: Any) -> None:
        self.task = task
        middle = task.starts_from(torch.full((1, task.num_draws), 0.5, dtype=torch.float64))
        self.env = make_env(task=task, num_envs=num_envs, starts=middle, **options)
        self.base = self.env.base_env
        self.policy = make_actor(
            num_inputs=task.num_stacked * task.n_obs,
            num_actions=task.num_actions,
            generator=torch.Generator().manual_seed(0),
        )
        self._in_flow = 0.0
        self._num_actions = NUM_ACTIONS
        self.state: TensorDictBase
        solver: Any = self.base.solver
        solver.advance_ = self._time_flow(solver.advance_)
        self.prepare()

    def prepare(self) -> None:
        """Begin new episodes where the old ones could soon end."""
        if self._num_actions >= NUM_ACTIONS:
            self.state = self.env.reset()
            self._num_actions = 0
        self._num_actions += 1

    def run_solver(self, num_steps: int) -> None:
        """Advance the flows, and nothing else."""
        for _ in range(num_steps):
            self.base.solver.advance_(self.task.n_substeps)

    def run_env(self, num_steps: int) -> dict[str, float]:
        """Step the bare environment; every fish keeps its heading."""
        keep = torch.ones(self.base.batch_size, dtype=torch.int64)
        return self._time(lambda: self.base.step(self.state.clone().set("action", keep)), num_steps)

    def run_policy(self, num_steps: int) -> dict[str, float]:
        """Step the whole environment as a collector does, with a policy's actions."""

        def act() -> None:
            with torch.no_grad(), set_exploration_type(ExplorationType.RANDOM):
                _, self.state = self.env.step_and_maybe_reset(self.policy(self.state))

        return self._time(act, num_steps)

    def _time(self, act: Callable[[], object], num_steps: int) -> dict[str, float]:
        """Act, and return the share of the time that was not spent in the flow."""
        self._in_flow, start = 0.0, time.perf_counter()
        for _ in range(num_steps):
            act()
        return {"share_outside_flow": 1.0 - self._in_flow / (time.perf_counter() - start)}

    def _time_flow(self, advance_: Callable[..., None]) -> Callable[..., None]:
        def timed(*arguments: Any, **keywords: Any) -> None:
            start = time.perf_counter()
            advance_(*arguments, **keywords)
            self._in_flow += time.perf_counter() - start

        return timed


def make_stage(*, body_length: int, num_envs: int, threads: int, compile: bool) -> list[Entry]:
    """Make the flows once, and the three ways to advance them by one action."""
    torch.set_num_threads(threads)
    stage = Stage(task=make_task(body_length), num_envs=num_envs, compile=compile)
    config, substeps = stage.base.solver.config, stage.task.n_substeps
    size = describe_size(config, num_envs)
    return [
        Entry(
            label=f"env/{label}",
            name=f"{size}, {name}",
            scope=FISH,
            advance=advance,
            num_nodes=num_envs * config.width * config.height * substeps,
            num_steps=1,
            prepare=stage.prepare,
            unit="action",
            facts={"substeps": substeps, "num_envs": num_envs},
        )
        for label, name, advance in (
            ("solver", "bare solver", stage.run_solver),
            ("env", "environment", stage.run_env),
            ("policy", "environment, transforms and policy", stage.run_policy),
        )
    ]


def list_teams(settings: Settings) -> list[Team]:
    """Return the process of the environment, at the preset's number of flows."""
    arguments = {
        "body_length": settings.body_length // 2,
        "num_envs": load_config("train", ["preset=small"]).num_envs,
        "threads": settings.threads,
        "compile": True,
    }
    return [Team(code=CODE, group="env", make=make_stage, arguments=arguments)]
