"""Cost beyond the flow: the environment, a training run, a live view, and a profile.

One action lasts a tail beat. The same flows are advanced by the bare solver, by the environment,
and by the environment with its transforms, resets and a policy. No episode ends meanwhile, so the
steps are the same.
"""

from __future__ import annotations

import atexit
import time
from collections import defaultdict
from collections.abc import Callable
from functools import partial
from typing import Any

import torch
from tensordict import TensorDictBase
from torch.profiler import ProfilerActivity, profile, record_function
from torchrl.envs import ExplorationType, set_exploration_type

from experiments.benchmarks.contest import FISH, Entry, Settings
from experiments.benchmarks.flows import wrap_parts
from fishrl.envs import Predation, make_env
from fishrl.modules import make_actor
from fishrl.physics import InPlaceSolver
from fishrl.training.algorithms import DiscreteSAC
from fishrl.training.collector import ResumableCollector
from fishrl.training.learner import one_thread
from fishrl.training.policy_spec import PolicySpec
from fishrl.training.settings import LearningSettings
from fishrl.viewer import LiveView, ViewerSettings

NUM_ENVS = 16
NUM_ACTIONS = 5  # until the flows are reset, outside the time: no fish has reached a wall by then


def make_task(settings: Settings) -> Predation:
    """Return the task of preset ``small``, at its relaxation time also where L / 2 is not 50."""
    length = settings.body_length // 2
    return Predation(body_length=length, reynolds=140.0 * length)


class Stage:
    """Flows, the environment around them and a policy; ``options`` are those of ``make_env``."""

    def __init__(self, task: Any, num_envs: int, **options: Any) -> None:
        self.task = task
        middle = task.starts_from(torch.full((1, task.num_draws), 0.5, dtype=torch.float64))
        self.env = make_env(task=task, num_envs=num_envs, starts=middle, **options)
        self.base = self.env.base_env
        self.policy: Any = make_actor(
            num_inputs=task.num_stacked * task.n_obs,
            num_actions=task.num_actions,
            generator=torch.Generator().manual_seed(0),
        )
        self._in_flow, self._num_actions = 0.0, NUM_ACTIONS
        solver: Any = self.base.solver
        self._advance_, solver.advance_ = solver.advance_, self._time_flow
        self.prepare()

    def prepare(self) -> None:
        """Begin new episodes where the old ones could soon end."""
        if self._num_actions >= NUM_ACTIONS:
            self.state: TensorDictBase = self.env.reset()
            self._num_actions = 0
        self._num_actions += 1

    def run_solver(self, num_actions: int) -> None:
        """Advance the flows by an action, and nothing else."""
        self.base.solver.advance_(self.task.n_substeps)

    def run_env(self, num_actions: int) -> dict[str, float]:
        """Step the bare environment by an action; every fish keeps its heading."""
        keep = torch.ones(self.base.batch_size, dtype=torch.int64)
        return self._time(lambda: self.base.step(self.state.clone().set("action", keep)))

    def run_policy(self, num_actions: int) -> dict[str, float]:
        """Step the whole environment as a collector does, with an action of a policy."""
        return self._time(self.act)

    def act(self) -> TensorDictBase:
        """Take one action of the policy, and return the step."""
        with torch.no_grad(), set_exploration_type(ExplorationType.RANDOM):
            step, self.state = self.env.step_and_maybe_reset(self.policy(self.state))
        return step

    def _time(self, act: Callable[[], object]) -> dict[str, float]:
        self._in_flow, start = 0.0, time.perf_counter()
        act()
        return {"outside_flow": 1.0 - self._in_flow / (time.perf_counter() - start)}

    def _time_flow(self, *arguments: Any, **keywords: Any) -> None:
        start = time.perf_counter()
        self._advance_(*arguments, **keywords)
        self._in_flow += time.perf_counter() - start


def make_action_entry(base: Any, label: str, what: str, advance: Any, **options: Any) -> Entry:
    """Return bursts of one action of all flows of an environment."""
    config, num_envs = base.solver.config, base.batch_size[0]
    return Entry(
        label=label,
        name=f"{num_envs} × {config.width} × {config.height}, {what}",
        scope=FISH,
        advance=advance,
        num_nodes=num_envs * config.width * config.height * base.task.n_substeps,
        num_steps=1,
        **options,
    )


def make_stage(settings: Settings) -> list[Entry]:
    """Make the flows once, and the three ways to advance them by one action."""
    stage = Stage(make_task(settings), NUM_ENVS)
    return [
        make_action_entry(stage.base, f"env/{label}", what, advance, prepare=stage.prepare)
        for label, what, advance in (
            ("solver", "bare solver", stage.run_solver),
            ("env", "environment", stage.run_env),
            ("policy", "environment, transforms and policy", stage.run_policy),
        )
    ]


def make_training(settings: Settings) -> list[Entry]:
    """Make a training run at the default settings."""
    return list_training(LearningSettings(num_envs=NUM_ENVS), make_task(settings))


def list_training(settings: LearningSettings, task: Any, **options: Any) -> list[Entry]:
    """Return a gradient step, and a frame of all flows with the gradient steps it brings."""
    learner = DiscreteSAC().make_learner(PolicySpec.for_task(task), settings)
    env = make_env(task=task, num_envs=settings.num_envs, **options)
    batches = iter(
        ResumableCollector(
            env, learner.explorer, frames_per_batch=settings.num_envs, total_frames=-1,
            init_random_frames=settings.warmup_frames,
        )
    )  # fmt: skip
    num_updates = round(settings.updates_per_frame * settings.num_envs)

    def collect() -> None:
        learner.remember(next(batches).reshape(-1))

    def learn(num_steps: int) -> None:
        with one_thread():
            for _ in range(num_steps):
                learner.update()

    def run(num_batches: int) -> dict[str, float]:
        start = time.perf_counter()
        collect()
        middle = time.perf_counter()
        learn(num_updates)
        end = time.perf_counter()
        return {"learning": (end - middle) / (end - start)}

    while len(learner.buffer) < settings.batch_size:
        collect()
    name = f"gradient step, {settings.batch_size} transitions"
    what = f"frame of all flows, {num_updates} gradient steps"
    return [
        Entry(label="train/gradient", name=name, advance=learn),
        make_action_entry(env.base_env, "train/frame", what, run),
    ]


def make_live(settings: Settings) -> list[Entry]:
    """Make actions of four flows of preset ``small`` without and with a live view of flow 0."""
    return list_views(make_task(settings), num_envs=4)


def list_views(task: Any, *, num_envs: int, port: int = 9876, **options: Any) -> list[Entry]:
    """Return actions of the same flows without and with a live view that leaves out no frame.

    Other load changes the time of an action, and hardly the processor time of this process; the
    flows have processes of their own.
    """
    stage = Stage(task, num_envs, frames_per_action=task.checks_per_action, **options)
    live = LiveView(stage.env, ViewerSettings(port=port, live_share=1.0))
    atexit.register(live.close)
    look = stage.base.on_frame

    def decide(num_actions: int, *, is_live: bool) -> dict[str, float]:
        stage.base.on_frame = look if is_live else None
        start, busy = time.perf_counter(), time.process_time()
        step = stage.act()
        if is_live:
            live.settle(step)
        return {"processor": (time.process_time() - busy) / (time.perf_counter() - start)}

    return [
        make_action_entry(stage.base, f"live/{word}", what, partial(decide, is_live=is_live))
        for word, what, is_live in (
            ("without", "no view", False),
            ("with", "live view of one flow", True),
        )
    ]


def make_profile(settings: Settings) -> list[Entry]:
    """Profile three actions of four flows on one core, all in this process."""
    torch.set_num_threads(1)
    return list_parts(make_task(settings), num_envs=4, num_actions=3)


def list_parts(task: Any, *, num_envs: int, num_actions: int, compile: bool = True) -> list[Entry]:
    """Return the parts of an environment step and their seconds per action."""
    stage = Stage(task, num_envs, compile=False)
    solver: Any = InPlaceSolver(
        config=task.flow_config(), num_envs=num_envs, frequency=1.0 / task.scales.period,
        num_workers=0, compile=compile,
    )  # fmt: skip
    solver.compile()
    stage.base.solver = solver
    stage.prepare()
    places: dict[str, str] = {}  # of each part

    def name(place: str, part: str, function: Callable[..., Any]) -> Callable[..., Any]:
        places[part] = place

        def named(*arguments: Any, **keywords: Any) -> Any:
            with record_function(part):
                return function(*arguments, **keywords)

        return named

    wrap_parts(solver, partial(name, "flow"))
    for owner, attribute, place, part in (
        (solver, "advance_", "flow", "calls, and what is in no part"),
        (solver, "is_diverged", "environment", "check for divergence"),
        (stage.base, "measure", "environment", "sensors and measurement"),
        (stage.base, "_step", "environment", "reward, observation, ends"),
        (stage.env, "step_and_maybe_reset", "TorchRL and policy", "transforms, specs, resets"),
        (stage, "policy", "TorchRL and policy", "policy"),
    ):
        setattr(owner, attribute, name(place, part, getattr(owner, attribute)))
    stage.act()
    with profile(activities=[ProfilerActivity.CPU], acc_events=True) as profiler:
        for _ in range(num_actions):
            stage.act()
    seconds: dict[str, float] = defaultdict(float)
    for event in profiler.events():
        owner = event
        while owner is not None and owner.name not in places:
            owner = owner.cpu_parent
        if owner is not None:
            seconds[owner.name] += 1e-6 * event.self_cpu_time_total / num_actions
    size = f"{num_envs} × {solver.config.width} × {solver.config.height}, {task.n_substeps} steps"
    total = sum(seconds.values())
    return [
        Entry(
            label=f"profile/{part}", name=part, num_steps=0,
            facts={"place": places[part], "seconds": s, "share": s / total, "size": size},
        )
        for part, s in sorted(seconds.items(), key=lambda item: -item[1])
    ]  # fmt: skip
