"""A fish learns to bend and beat its way to a place: by gradients through the flow, and by SAC.

    python examples/gradient_control.py shac      # three seeds, 2.5 CPU-minutes each
    python examples/gradient_control.py sac
    python examples/gradient_control.py steer     # the hand-crafted controller
    python examples/gradient_control.py horizons  # the gradient and its cost
    python examples/gradient_control.py figure

Both learn the same task with the same policy network for the same CPU time, all processes counted,
and are evaluated in the same ``FlowEnv`` from the same held-out starts.
"""

import argparse
import json
import os
from collections.abc import Iterable
from contextlib import closing, suppress
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import cached_property, partial
from math import inf, pi, radians
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, ClassVar, NamedTuple

import psutil
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor, nn
from torch.utils._pytree import tree_map
from torchrl.modules import MLP, ProbabilisticActor
from torchrl.objectives.value.functional import vec_td_lambda_return_estimate

from fishrl.envs import Command, make_env, run_episodes
from fishrl.envs.checks import Problems, scale_action
from fishrl.envs.episodes import Policy
from fishrl.envs.macro_actions import (
    AbstractFrequencyTask,
    BendControl,
    ContinuousFrequency,
    FrequencyControl,
)
from fishrl.envs.sensors import compute_clearance
from fishrl.envs.starts import place_fish
from fishrl.modules import make_continuous_actor
from fishrl.physics import Fish
from fishrl.physics.bodies.state import BodyState, make_body
from fishrl.physics.fast.solver import InPlaceSolver
from fishrl.physics.flow import Coupling, FlowConfig, FlowParams, FlowState, make_params, make_rest
from fishrl.physics.geometry import locate_markers
from fishrl.physics.rollout import simulate
from fishrl.training import Callback, Plan, begin
from fishrl.training.algorithms.sac import SAC

#: What is known of a policy, or of a horizon.
Row = dict[str, Any]


class Approach(AbstractFrequencyTask):
    """Bring the centre of mass to a place ahead, in still water, by bend and tail beat."""

    success: ClassVar[str] = "reached"
    n_obs: ClassVar[int] = 9
    num_actions: ClassVar[int] = 2
    num_draws: ClassVar[int] = 2

    body_length: int = 16
    reynolds: float = 500.0
    max_wall_speed: float = 0.15
    domain_bl: tuple[float, float] = (3.0, 3.0)
    wall_margin_bl: float = 0.16
    num_stacked: int = 1
    time_limit: int = 20
    control_interval_T: float = 0.5
    checks_per_action: int = 21
    control: FrequencyControl = BendControl(beat=ContinuousFrequency(frequency_range=(0.5, 1.0)))
    coupling: Coupling = Coupling.IMPLICIT
    inset: float = 0.45
    centre_bl: tuple[float, float] = (1.9, 1.5)
    distance_bl: tuple[float, float] = (0.4, 0.8)
    angle_degrees: float = 50.0
    reach_bl: float = 0.15
    work_weight: float = 0.1

    @cached_property
    def fish(self) -> Fish:
        """A free fish that bends."""
        return replace(super().fish, inset=self.inset)

    def starts_from(self, uniform: Tensor) -> TensorDict:
        """Draw the place's distance and its angle from the line ahead of the fish."""
        low, high = self.distance_bl
        distance = low + (high - low) * uniform[:, 0]
        angle = radians(self.angle_degrees) * (2.0 * uniform[:, 1] - 1.0)
        centre = self.body_length * uniform.new_tensor(self.centre_bl).expand(len(uniform), 2)
        ahead = torch.stack((-angle.cos(), -angle.sin()), -1)
        starts = {
            "head": centre - uniform.new_tensor((self.fish.centre, 0.0)),
            "heading": torch.full_like(angle, pi),
            "goal": centre + self.body_length * distance[:, None] * ahead,
        }
        return TensorDict(starts, uniform.shape[:1], device=uniform.device)

    def command(self, action: Tensor, before: TensorDictBase) -> Command:
        """Bend and beat."""
        bend, frequency = action.unbind(-1)
        return Command(bend, frequency / self.scales.period)

    def measure(self, solver: InPlaceSolver, starts: TensorDictBase) -> TensorDict:
        """Measure the place from the fish, in its frame, and the fish's own motion."""
        body, scales = solver.body, self.scales
        axis = body.heading + body.internal_angle
        cos, sin = axis.cos(), axis.sin()

        def turn(vector: Tensor) -> Tensor:
            x, y = vector.unbind(-1)
            return torch.stack((cos * x + sin * y, cos * y - sin * x), -1)

        away = (starts["goal"] - body.position) / self.body_length
        rates = (body.angular_velocity * scales.period, body.frequency * scales.period)
        now = {
            "away": turn(away),
            "distance": away.norm(dim=-1),
            "velocity": turn(body.velocity) / scales.reference_speed,
            "own": torch.stack((*rates, body.phase.sin(), body.phase.cos(), -body.bend), -1),
            "work": body.work / (scales.reference_speed * self.body_length) ** 2,
            "clearance": compute_clearance(solver.markers(), solver.config),
        }
        return TensorDict(now, starts.batch_size)

    def sense(self, now: TensorDictBase) -> Tensor:
        """Return the place, velocity, yaw rate, frequency, phase and bend, float64."""
        return torch.cat((now["away"], now["velocity"], now["own"]), -1)

    def observe(self, now: TensorDictBase) -> Tensor:
        """Return ``sense``."""
        return self.sense(now).float()

    def reward(self, before: TensorDictBase, now: TensorDictBase) -> Tensor:
        """Return the approach in L minus the weighted work."""
        work = self.work_weight * (now["work"] - before["work"])
        return before["distance"] - now["distance"] - work

    def is_terminated(self, now: TensorDictBase) -> Tensor:
        """Return whether the place is reached or a wall is near."""
        return (now["distance"] < self.reach_bl) | (now["clearance"] < self.wall_margin)

    def count_safe_steps(self, now: TensorDictBase) -> Tensor:
        """Return how long the fish takes at least to a wall and to the place."""
        to_goal = (now["distance"] - self.reach_bl) * self.body_length
        nearest = torch.minimum(now["clearance"] - self.wall_margin, to_goal)
        return nearest / self.swimming_speed

    def report(self, now: TensorDictBase) -> dict[str, Tensor]:
        """Return whether the place is reached."""
        return {"reached": now["distance"] < self.reach_bl}


class Flows(NamedTuple):
    """Differentiable flows, as a task measures those of an ``InPlaceSolver``."""

    config: FlowConfig
    params: FlowParams
    state: FlowState

    @property
    def body(self) -> BodyState:
        """The fish."""
        return self.state.bodies[0]

    def markers(self) -> Tensor:
        """Return its outline ``[B, N, 2]``, nose first."""
        return locate_markers(self.params.bodies[0], self.body)


class Swimmers:
    """B episodes of a task in differentiable flows, with the decisions of ``FlowEnv``.

    Unlike there, an episode that ends within a decision lasts until the end of the decision.

    Attributes:
        starts: ``[B]``, of the present episodes.
        flows: the flows.
        now: measurement ``[B]`` behind the next decision.
    """

    def __init__(
        self,
        task: Approach,
        num_envs: int,
        *,
        seed: int = 0,
        compile: bool = True,
        dtype: torch.dtype = torch.float32,
    ) -> None:
        self.task, self.num_envs, self.compile, self.dtype = task, num_envs, compile, dtype
        self.generator, config = torch.Generator().manual_seed(seed), task.flow_config()
        self.starts = task.sample_starts(num_envs, self.generator)
        self.flows = Flows(config, make_params([config] * num_envs), self._make_rest(config))
        self.now = task.measure(self.flows, self.starts)
        self.age = torch.zeros(num_envs)
        simulate(self.flows.state, config, self.flows.params, num_steps=1, compile=compile)

    def _make_rest(self, config: FlowConfig) -> FlowState:
        """Return still water with the fish at their starts."""
        position, heading = place_fish(self.starts, self.task.fish)
        fish = make_body(position, heading, torch.full_like(heading, 1.0 / self.task.scales.period))
        f = make_rest(config, self.num_envs, self.dtype)
        return FlowState(f, (fish,), torch.full_like(heading, inf))

    def observe(self) -> Tensor:
        """Return the observation ``[B, n]``."""
        return self.task.sense(self.now).to(self.dtype)

    def reset_(self, rows: Tensor) -> None:
        """Begin new episodes in ``rows`` ``[B]`` bool."""
        choose = partial(_choose, rows)
        fresh = self.task.sample_starts(self.num_envs, self.generator)
        self.starts = fresh.apply(choose, self.starts)
        rest = self._make_rest(self.flows.config)
        self.flows = self.flows._replace(state=tree_map(choose, rest, self.flows.state))
        self.now = self.task.measure(self.flows, self.starts)
        self.age = self.age.masked_fill(rows, 0)

    def detach_(self) -> None:
        """Forget how the flows came about, for gradients."""
        state = tree_map(Tensor.detach, self.flows.state)
        self.flows, self.now = self.flows._replace(state=state), self.now.detach()

    def step(self, action: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Take actions ``[B, 2]`` in [-1, 1]; return reward, terminated and done ``[B]``."""
        task, before, (config, params, state) = self.task, self.now, self.flows
        command = task.command(scale_action(action, task.action_bounds, Problems()), before)
        num_steps = task.n_substeps
        fish = self.flows.body._replace(
            turn=command.turn,
            frequency=command.frequency,
            turn_steps=torch.full_like(command.turn, num_steps),
            turn_clock=torch.zeros_like(command.turn),
        )
        state, _ = simulate(
            state._replace(bodies=(fish,)),
            config,
            params,
            num_steps=num_steps,
            segment=num_steps,
            compile=self.compile,
        )
        self.flows, self.age = self.flows._replace(state=state), self.age + 1
        self.now = task.measure(self.flows, self.starts)
        terminated = task.is_terminated(self.now)
        return task.reward(before, self.now), terminated, terminated | (self.age >= task.time_limit)


def _choose(rows: Tensor, new: Tensor, old: Tensor) -> Tensor:
    """Return ``new`` in ``rows`` ``[B]`` and ``old`` elsewhere."""
    return torch.where(rows.view(-1, *(1,) * (new.dim() - 1)), new, old)


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Hyper-parameters; those of SHAC are named as in Xu et al. 2022 (arXiv 2204.07137)."""

    num_envs: int = 8
    hidden: tuple[int, ...] = (64, 64)
    gamma: float = 0.95
    horizon: int = 4
    td_lambda: float = 0.95
    actor_rate: float = 1e-2
    critic_rate: float = 3e-3
    critic_steps: int = 32
    noise: float = 0.2
    max_norm: float = 1.0
    seed: int = 0
    compile: bool = True


def unroll(
    swimmers: Swimmers, actor: nn.Module, critic: nn.Module, settings: Settings
) -> tuple[Tensor, TensorDict]:
    """Swim for one horizon; return the discounted return ``[B]`` to differentiate, and the data.

    The critic continues the return at the horizon and where an episode runs out of time. The data
    are ``[B, horizon]``, for the critic.
    """
    dtype, noted = swimmers.dtype, []
    returned = torch.zeros(swimmers.num_envs, dtype=dtype)
    weight = torch.ones_like(returned)
    for number in range(settings.horizon):
        observation = swimmers.observe()
        loc = actor(TensorDict({"observation_stack": observation}, [len(weight)]))["loc"]
        action = torch.tanh(loc + settings.noise * torch.randn_like(loc))
        reward, terminated, done = swimmers.step(action)
        reward, after = reward.to(dtype), swimmers.observe()
        is_cut = done | (number == settings.horizon - 1)
        value = critic(after).squeeze(-1).masked_fill(terminated | ~is_cut, 0.0)
        returned = returned + weight * (reward + settings.gamma * value)
        weight = torch.where(done, 1.0, settings.gamma * weight)
        entries = {"observation": observation, "after": after}
        flags = {"reward": reward, "terminated": terminated, "done": done}
        columns = {name: value[:, None] for name, value in flags.items()}
        noted.append(TensorDict(entries | columns, [len(weight)]).detach())
        if done.any():
            swimmers.reset_(done)
    return returned, torch.stack(noted, 1)


class OutOfTime(Exception):
    """The CPU time of a training is spent."""


class Watch(Callback):
    """Keep the policy at equal intervals of CPU time, and end the training after the last.

    Args:
        minutes: CPU time, from ``start`` on.
        num: number of policies to keep.

    Attributes:
        kept: policies, and what each took: CPU seconds of set-up and of learning, and decisions.
    """

    def __init__(self, minutes: float, *, num: int = 5) -> None:
        self.interval, self.num, self.made = 60.0 * minutes / num, num, count_cpu_seconds()
        self.kept: list[tuple[Row, nn.Module]] = []

    def start(self, actor: nn.Module) -> None:
        """Begin to count."""
        self.actor, self.frames, self.began = actor, 0, count_cpu_seconds()

    def on_step(self, step: TensorDictBase) -> None:
        """Count the decisions of completed steps; raise ``OutOfTime`` at the end."""
        self.frames += step.numel()
        seconds = count_cpu_seconds() - self.began
        if seconds >= self.interval * (len(self.kept) + 1):
            took = {
                "set_up_seconds": self.began - self.made,
                "seconds": seconds,
                "frames": self.frames,
            }
            self.kept.append((took, deepcopy(self.actor)))
            if len(self.kept) == self.num:
                raise OutOfTime


def count_cpu_seconds() -> float:
    """Return the CPU time of this process and of those that advance flows or compile for it."""
    seconds, me = sum(os.times()[:4]), psutil.Process()
    for process in me.children(recursive=True):
        with suppress(psutil.Error):  # it has ended
            seconds += sum(process.cpu_times()[:2])
    return seconds


def make_policy(settings: Settings) -> ProbabilisticActor:
    """Return the policy of SHAC, such as that of SAC."""
    return make_continuous_actor(
        num_inputs=Approach.n_obs,
        num_actions=Approach.num_actions,
        hidden=settings.hidden,
        generator=torch.Generator().manual_seed(settings.seed),
    )


def train_shac(task: Approach, watch: Watch, settings: Settings) -> None:
    """Ascend the return of short horizons along its gradient, until ``watch`` ends it."""
    swimmers = Swimmers(task, settings.num_envs, seed=settings.seed, compile=settings.compile)
    torch.manual_seed(settings.seed)
    actor = make_policy(settings)
    watch.start(actor)
    critic = MLP(Approach.n_obs, 1, num_cells=settings.hidden, activation_class=nn.SiLU)
    target = deepcopy(critic)
    of_actor = torch.optim.Adam(actor.parameters(), settings.actor_rate, betas=(0.7, 0.95))
    of_critic = torch.optim.Adam(critic.parameters(), settings.critic_rate)
    while True:
        swimmers.detach_()
        returned, window = unroll(swimmers, actor, target, settings)
        of_actor.zero_grad()
        (-returned.mean()).backward()
        norm = nn.utils.clip_grad_norm_(actor.parameters(), settings.max_norm)
        if norm.isfinite():
            of_actor.step()
        with torch.no_grad():
            goals = vec_td_lambda_return_estimate(
                settings.gamma,
                settings.td_lambda,
                target(window["after"]),
                window["reward"],
                window["done"],
                window["terminated"],
            )
        for _ in range(settings.critic_steps):
            loss = (critic(window["observation"]) - goals).square().mean()
            of_critic.zero_grad()
            loss.backward()
            of_critic.step()
        with torch.no_grad():
            for old, new in zip(target.parameters(), critic.parameters(), strict=True):
                old.lerp_(new, 0.8)
        watch.on_step(window)


def train_sac(task: Approach, watch: Watch, settings: Settings) -> None:
    """Train with the project's loop and its defaults until ``watch`` ends it."""
    never, shared = 10**9, ("seed", "num_envs", "gamma", "hidden", "compile")
    with TemporaryDirectory() as folder:
        plan = Plan(
            task=task,
            algorithm=SAC(),
            folder=folder,
            total_frames=never,
            eval_frames=never,
            checkpoint_frames=never,
            **{name: getattr(settings, name) for name in shared},
        )
        with closing(begin(plan, callbacks=[watch])) as training:
            watch.start(training.learner.actor)
            training.run()


def steer(state: TensorDictBase) -> TensorDictBase:
    """Bend in proportion to the bearing of the place, at full tail beat: the baseline."""
    ahead, left = state["observation"].unbind(-1)[:2]
    bend = (2.0 * torch.atan2(left, ahead)).clamp(-1.0, 1.0)
    return state.set("action", torch.stack((bend, torch.ones_like(bend)), -1))


def evaluate(task: Approach, policies: Iterable[Policy]) -> list[Row]:
    """Return the metrics of each policy from 32 held-out starts, in the env of SAC."""
    starts = task.sample_starts(32, torch.Generator().manual_seed(10**6))
    with closing(make_env(task=task, num_envs=8)) as env:
        return [run_episodes(env, policy, starts).metrics() for policy in policies]


def learn(method: str, task: Approach, watch: Watch, settings: Settings) -> list[Row]:
    """Train by a method and return the metrics of the policies that were kept."""
    with suppress(OutOfTime):
        {"shac": train_shac, "sac": train_sac}[method](task, watch, settings)
    took, policies = zip(*watch.kept, strict=True)
    metrics = evaluate(task, policies)
    return [{"seed": settings.seed, **a, **b} for a, b in zip(took, metrics, strict=True)]


def measure_horizons(num: int = 8) -> list[Row]:
    """Return how the return of a fish that swims straight rises with its tail beat, by horizon.

    ``slope`` is the rise of the return from 65 to 85 % of the range of tail beats, divided by the
    range between them in actions; ``gradient`` the mean of the derivatives at ``num`` beats there.
    """
    task, rows = Approach(distance_bl=(0.8, 0.8), angle_degrees=0.0), []
    for horizon in (1, 2, 4, 8, 12, 16):
        swimmers = Swimmers(task, num)
        beat = torch.linspace(0.3, 0.7, num, requires_grad=True)
        returned, began = torch.zeros(num), count_cpu_seconds()
        for _ in range(horizon):
            returned = returned + swimmers.step(torch.stack((torch.zeros(num), beat), 1))[0]
        between = count_cpu_seconds()
        (gradient,) = torch.autograd.grad(returned.sum(), beat)
        ended, steps = count_cpu_seconds(), 1e-3 * horizon * task.n_substeps
        rows.append(
            {
                "horizon_T": horizon * task.interval_T,
                "slope": float((returned[-1] - returned[0]).detach() / 0.4),
                "gradient": float(gradient.mean()),
                "forward_ms_per_step": (between - began) / steps,
                "backward_ms_per_step": (ended - between) / steps,
            }
        )
    return rows


def draw(folder: Path, path: Path) -> None:
    """Draw what ``main`` wrote: success by CPU time, and the gradient by horizon."""
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(9.0, 3.4), layout="constrained")
    for method, colour in (("shac", "C0"), ("sac", "C1")):
        rows = json.loads((folder / f"{method}.json").read_text())
        for number, seed in enumerate(sorted({row["seed"] for row in rows})):
            own = [row for row in rows if row["seed"] == seed]
            minutes = [row["seconds"] / 60.0 for row in own]
            shares = [row["success_rate"] for row in own]
            left.plot(minutes, shares, color=colour, label=None if number else method.upper())
    (steered,) = json.loads((folder / "steer.json").read_text())
    left.axhline(steered["success_rate"], color="grey", ls="--", label="hand-crafted")
    left.set(xlabel="CPU time [min]", ylabel="share of 32 places reached", ylim=(0.0, 1.0))
    rows = json.loads((folder / "horizons.json").read_text())
    times = [row["horizon_T"] for row in rows]
    right.plot(times, [row["gradient"] for row in rows], "C0o-", label="gradient")
    right.plot(times, [row["slope"] for row in rows], "k:", label="slope")
    right.set(xlabel="horizon [T]", ylabel="d return [L] / d tail beat", ylim=(0.0, None))
    for axes in (left, right):
        axes.legend()
    figure.savefig(path, dpi=150)


def main() -> None:
    """Learn by a method, write the metrics and print them; or draw those written."""
    parser = argparse.ArgumentParser(description="Control by gradients through the flow, and SAC.")
    parser.add_argument("what", choices=["shac", "sac", "steer", "horizons", "figure"])
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--minutes", type=float, default=2.5, help="CPU time of each training")
    parser.add_argument("--folder", type=Path, default=Path("runs/gradient_control"))
    chosen = parser.parse_args()
    torch.set_num_threads(1)
    chosen.folder.mkdir(parents=True, exist_ok=True)
    if chosen.what == "figure":
        draw(chosen.folder, chosen.folder / "gradient_control.png")
        return
    if chosen.what == "steer":
        rows = evaluate(Approach(), [steer])
    elif chosen.what == "horizons":
        rows = measure_horizons()
    else:
        rows = []
        for seed in chosen.seeds:
            watch = Watch(chosen.minutes)
            rows += learn(chosen.what, Approach(), watch, Settings(seed=seed))
    (chosen.folder / f"{chosen.what}.json").write_text(json.dumps(rows, indent=1))
    for row in rows:
        print(row)


if __name__ == "__main__":
    main()
