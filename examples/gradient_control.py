"""A fish learns to bend and beat towards food: by gradients through the flow, and by SAC.

    python examples/gradient_control.py shac --seed 0 --minutes 5   # writes shac-0.json
    python examples/gradient_control.py sac --seed 0 --minutes 5
    python examples/gradient_control.py steer                       # the hand-crafted controller
    python examples/gradient_control.py horizons                    # gradient against horizon
    python examples/gradient_control.py figure

Both learn the same task with the same policy network for the same CPU time, all processes counted
(on Linux), and are evaluated in the same ``FlowEnv`` from the same held-out starts.
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

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor, nn
from torch.utils import _pytree as pytree
from torchrl.modules import MLP, ProbabilisticActor

from fishrl.envs import AbstractTask, Command, make_env, run_episodes
from fishrl.envs.checks import scale_action
from fishrl.envs.episodes import Policy
from fishrl.envs.macro_actions import BendControl, ContinuousFrequency, FrequencyControl
from fishrl.envs.sensors import compute_clearance
from fishrl.envs.starts import place_fish
from fishrl.modules import make_continuous_actor
from fishrl.physics import Fish
from fishrl.physics.bodies.state import BodyState, make_body
from fishrl.physics.flow import FlowConfig, FlowParams, FlowState, make_params, make_rest
from fishrl.physics.geometry import locate_markers
from fishrl.physics.rollout import simulate
from fishrl.training import Callback, LearningSettings, Plan, RunSettings, begin
from fishrl.training.algorithms.sac import SAC


class Approach(AbstractTask):
    """Reach food at rest somewhere ahead, in a tank of still water, by bend and tail beat."""

    success: ClassVar[str] = "reached"
    n_obs: ClassVar[int] = 9
    num_actions: ClassVar[int] = 2
    num_draws: ClassVar[int] = 2

    body_length: int = 16
    reynolds: float = 500.0
    max_wall_speed: float = 0.15
    domain_bl: tuple[float, float] = (4.0, 4.0)
    wall_margin_bl: float = 0.16
    num_stacked: int = 1
    time_limit: int = 20
    control_interval_T: float = 0.5
    checks_per_action: int = 21
    control: FrequencyControl = BendControl(beat=ContinuousFrequency(frequency_range=(0.5, 1.0)))
    nose_bl: tuple[float, float] = (2.5, 2.0)
    distance_bl: tuple[float, float] = (0.8, 1.6)
    angle_degrees: float = 50.0
    reach_bl: float = 0.25
    work_weight: float = 0.1

    @property
    def action_bounds(self) -> tuple[tuple[float, float], ...] | None:
        """Bend in L and tail beats per T."""
        return self.control.action_bounds

    @property
    def max_frequency(self) -> float:
        """Highest frequency of ``control``."""
        return self.control.max_frequency

    @property
    def swimming_speed(self) -> float:
        """Bound on the speed of a marker, with a bend from one side to the other."""
        return super().swimming_speed + self.control.bend_rate_bl * self.scales.reference_speed

    @property
    def largest_turn(self) -> float:
        """Largest bend."""
        return self.control.bend_bl

    @cached_property
    def fish(self) -> Fish:
        """A free fish that bends."""
        return replace(super().fish, motion=self.control.make_motion(self.control_interval_T))

    def starts_from(self, uniform: Tensor) -> TensorDict:
        """Draw the food's distance and angle from the line ahead."""
        low, high = self.distance_bl
        distance = low + (high - low) * uniform[:, 0]
        angle = radians(self.angle_degrees) * (2.0 * uniform[:, 1] - 1.0)
        head = uniform.new_tensor(self.nose_bl).expand(len(uniform), 2)
        away = -distance[:, None] * torch.stack((angle.cos(), angle.sin()), -1)
        starts = {
            "head": self.body_length * head,
            "heading": torch.full_like(angle, pi),
            "food": self.body_length * (head + away),
        }
        return TensorDict(starts, uniform.shape[:1], device=uniform.device)

    def command(self, action: Tensor, before: TensorDictBase) -> Command:
        """Bend and beat."""
        bend, frequency = action.unbind(-1)
        return Command(bend, frequency / self.scales.period)

    def measure(self, solver, starts: TensorDictBase) -> TensorDict:
        """Measure the food from the nose, in the fish's frame, and the fish's own motion."""
        body, markers, scales = solver.body, solver.markers(), self.scales
        axis = body.heading + body.internal_angle
        cos, sin = axis.cos(), axis.sin()

        def turn(vector: Tensor) -> Tensor:
            x, y = vector.unbind(-1)
            return torch.stack((cos * x + sin * y, cos * y - sin * x), -1)

        away = turn(starts["food"] - markers[:, 0]) / self.body_length
        now = {
            "away": away,
            "distance": (starts["food"] - markers[:, 0]).norm(dim=-1) / self.body_length,
            "velocity": turn(body.velocity) / scales.reference_speed,
            "rates": torch.stack(
                (
                    body.angular_velocity * scales.period,
                    body.phase.sin(),
                    body.phase.cos(),
                    -body.bend,
                    body.frequency * scales.period,
                ),
                -1,
            ),
            "work": body.work / (scales.reference_speed * self.body_length) ** 2,
            "clearance": compute_clearance(markers, solver.config),
        }
        return TensorDict(now, starts.batch_size)

    def sense(self, now: TensorDictBase) -> Tensor:
        """Return place of the food, velocity, yaw rate, phase, bend and frequency, float64."""
        return torch.cat((now["away"], now["velocity"], now["rates"]), -1)

    def observe(self, now: TensorDictBase) -> Tensor:
        """Return ``sense``."""
        return self.sense(now).float()

    def reward(self, before: TensorDictBase, now: TensorDictBase) -> Tensor:
        """Return the approach in L minus the weighted work."""
        work = self.work_weight * (now["work"] - before["work"])
        return before["distance"] - now["distance"] - work

    def is_terminated(self, now: TensorDictBase) -> Tensor:
        """Return whether the food is reached or a wall is near."""
        return (now["distance"] < self.reach_bl) | (now["clearance"] < self.wall_margin)

    def count_safe_steps(self, now: TensorDictBase) -> Tensor:
        """Return how long the fish takes at least to a wall and to the food."""
        to_food = (now["distance"] - self.reach_bl) * self.body_length
        nearest = torch.minimum(now["clearance"] - self.wall_margin, to_food)
        return nearest / self.swimming_speed

    def report(self, now: TensorDictBase) -> dict[str, Tensor]:
        """Return whether the food is reached."""
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
        self.now, self.age = task.measure(self.flows, self.starts), torch.zeros(num_envs)

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
        self.flows = self.flows._replace(state=pytree.tree_map(choose, rest, self.flows.state))
        self.now, self.age = (
            self.task.measure(self.flows, self.starts),
            self.age.masked_fill(rows, 0.0),
        )

    def detach_(self) -> None:
        """Forget how the flows came about, for gradients."""
        state = pytree.tree_map(Tensor.detach, self.flows.state)
        self.flows, self.now = self.flows._replace(state=state), self.now.detach()

    def step(self, action: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Take actions ``[B, 2]`` in [-1, 1]; return reward, terminated and done ``[B]``."""
        task, before, (config, params, state) = self.task, self.now, self.flows
        command, num_steps = (
            task.command(scale_action(action, task.action_bounds), before),
            task.n_substeps,
        )
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
        self.flows, self.age = self.flows._replace(state=state), self.age + 1.0
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
    actor_rate: float = 3e-3
    critic_rate: float = 3e-3
    critic_steps: int = 32
    noise: float = 0.2
    max_norm: float = 1.0
    seed: int = 0


class Window(NamedTuple):
    """What a critic learns from, ``[horizon, B]``, without gradients."""

    observation: Tensor  #: ``[horizon, B, n]``
    after: Tensor  #: ``[horizon, B, n]`` before a reset
    reward: Tensor
    terminated: Tensor
    done: Tensor


def unroll(
    swimmers: Swimmers, actor: nn.Module, critic: nn.Module, settings: Settings
) -> tuple[Tensor, Window]:
    """Swim for one horizon; return the discounted return ``[B]`` to differentiate, and the data.

    The critic continues the return at the horizon and where an episode runs out of time.
    """
    dtype, noted = swimmers.dtype, []
    observation = swimmers.observe()
    returned, weight = torch.zeros(2, swimmers.num_envs, dtype=dtype)
    weight = weight + 1.0
    for number in range(settings.horizon):
        loc = actor(TensorDict({"observation_stack": observation}, observation.shape[:1]))["loc"]
        action = torch.tanh(loc + settings.noise * torch.randn_like(loc))
        reward, terminated, done = swimmers.step(action)
        reward, after = reward.to(dtype), swimmers.observe()
        is_cut = done | (number == settings.horizon - 1)
        value = critic(after).squeeze(-1).masked_fill(terminated | ~is_cut, 0.0)
        returned = returned + weight * (reward + settings.gamma * value)
        weight = torch.where(done, 1.0, settings.gamma * weight)
        noted.append((observation.detach(), after.detach(), reward.detach(), terminated, done))
        if done.any():
            swimmers.reset_(done)
        observation = swimmers.observe()
    return returned, Window(*map(torch.stack, zip(*noted, strict=True)))


def compute_targets(window: Window, critic: nn.Module, settings: Settings) -> Tensor:
    """Return the TD(lambda) targets ``[horizon, B]`` of the critic."""
    values, targets = critic(window.after).squeeze(-1), []
    target, keep = values[-1], settings.td_lambda
    for k in reversed(range(len(values))):
        mixed = torch.where(window.done[k], values[k], (1.0 - keep) * values[k] + keep * target)
        target = window.reward[k] + settings.gamma * mixed.masked_fill(window.terminated[k], 0.0)
        targets.append(target)
    return torch.stack(targets[::-1])


class OutOfTime(Exception):
    """The CPU time of a training is spent."""


class Watch(Callback):
    """Keep the policy at equal intervals of CPU time, and end the training after the last.

    Args:
        minutes: CPU time, from ``start`` on.
        num: number of policies to keep.

    Attributes:
        kept: CPU seconds, decisions and weights of each.
    """

    def __init__(self, minutes: float, *, num: int = 6) -> None:
        self.interval, self.num = 60.0 * minutes / num, num
        self.kept: list[tuple[float, int, dict[str, Any]]] = []

    def start(self, actor: nn.Module) -> None:
        """Begin to count."""
        self.actor, self.frames, self.began = actor, 0, count_cpu_seconds()

    def on_step(self, step: TensorDictBase) -> None:
        """Count the decisions of a completed step ``[B]``."""
        self.count(step.numel())

    def count(self, frames: int) -> None:
        """Count decisions; raise ``OutOfTime`` at the end."""
        self.frames += frames
        seconds = count_cpu_seconds() - self.began
        if seconds >= self.interval * (len(self.kept) + 1):
            self.kept.append((seconds, self.frames, deepcopy(self.actor.state_dict())))
            if len(self.kept) == self.num:
                raise OutOfTime


def count_cpu_seconds() -> float:
    """Return the CPU time of this process and of those that advance flows or compile for it."""
    seconds, me = sum(os.times()[:4]), os.getpid()
    for child in Path(f"/proc/{me}/task/{me}/children").read_text().split():
        with suppress(FileNotFoundError):
            fields = Path(f"/proc/{child}/stat").read_text().rpartition(")")[2].split()
            seconds += sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")
    return seconds


def make_policy(settings: Settings) -> ProbabilisticActor:
    """Return the policy that both methods train."""
    return make_continuous_actor(
        num_inputs=Approach.n_obs,
        num_actions=Approach.num_actions,
        hidden=settings.hidden,
        generator=torch.Generator().manual_seed(settings.seed),
    )


def train_shac(swimmers: Swimmers, actor: nn.Module, watch: Watch, settings: Settings) -> None:
    """Ascend the return of short horizons by its gradient through the flow, until time is out."""
    torch.manual_seed(settings.seed)
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
            targets = compute_targets(window, target, settings)
        for _ in range(settings.critic_steps):
            loss = (critic(window.observation).squeeze(-1) - targets).square().mean()
            of_critic.zero_grad()
            loss.backward()
            of_critic.step()
        with torch.no_grad():
            for old, new in zip(target.parameters(), critic.parameters(), strict=True):
                old.lerp_(new, 0.8)
        watch.count(window.reward.numel())


def train_sac(task: Approach, watch: Watch, settings: Settings) -> ProbabilisticActor:
    """Train with the project's loop and its defaults until time is out."""
    learning = LearningSettings(
        seed=settings.seed,
        num_envs=settings.num_envs,
        gamma=settings.gamma,
        hidden=settings.hidden,
    )
    with TemporaryDirectory() as folder:
        never = 10**9
        run = RunSettings(
            total_frames=never, eval_frames=never, checkpoint_frames=never, folder=folder
        )
        plan = Plan(task=task, algorithm=SAC(), **vars(learning), **vars(run))
        with closing(begin(plan, callbacks=[watch])) as training, suppress(OutOfTime):
            watch.start(training.learner.actor)
            training.run()
    return training.learner.actor


def load(actor: nn.Module, weights: dict[str, Any]) -> nn.Module:
    """Return the policy with these weights."""
    actor.load_state_dict(weights)
    return actor


def steer(state: TensorDictBase) -> TensorDictBase:
    """Bend in proportion to the bearing of the food, at full tail beat: the baseline."""
    ahead, left = state["observation"].unbind(-1)[:2]
    bend = torch.atan2(left, ahead).clamp(-1.0, 1.0)
    return state.set("action", torch.stack((bend, torch.ones_like(bend)), -1))


def measure_horizons(swimmers: Swimmers, actor: nn.Module, num: int = 4) -> list[dict[str, float]]:
    """Return norm, spread and cost of the return's gradient by horizon, from starts at rest.

    The spread is the root-mean-square distance of the gradients of ``num`` batches from their mean.
    """
    rows = torch.ones(swimmers.num_envs, dtype=torch.bool)
    measured = []
    for horizon in (1, 2, 4, 8, 16):
        settings, gradients = Settings(horizon=horizon, noise=0.0, gamma=1.0), []
        times = [count_cpu_seconds()]
        for _ in range(num):
            swimmers.reset_(rows)
            swimmers.detach_()
            returned, _ = unroll(swimmers, actor, lambda seen: torch.zeros(len(seen), 1), settings)
            times.append(count_cpu_seconds())
            gradient = torch.autograd.grad(returned.mean(), [*actor.parameters()])
            gradients.append(torch.cat([part.flatten() for part in gradient]))
            times.append(count_cpu_seconds())
        seconds, mean = (
            torch.tensor(times).diff().view(num, 2).mean(0),
            torch.stack(gradients).mean(0),
        )
        spread = (torch.stack(gradients) - mean).square().sum(1).mean().sqrt()
        measured.append(
            {
                "horizon": horizon,
                "norm": float(mean.norm()),
                "spread": float(spread),
                "forward_seconds": float(seconds[0]),
                "backward_seconds": float(seconds[1]),
            }
        )
    return measured


def evaluate(task: Approach, policies: Iterable[Policy]) -> list[dict[str, float]]:
    """Return the metrics of each policy from 32 held-out starts, in the env of SAC."""
    starts = task.sample_starts(32, torch.Generator().manual_seed(10**6))
    with closing(make_env(task=task, num_envs=8)) as env:
        return [run_episodes(env, policy, starts).metrics() for policy in policies]


def main() -> None:
    """Train and evaluate, and write the result."""
    parser = argparse.ArgumentParser(description="Control by gradients through the flow, and SAC.")
    parser.add_argument("method", choices=["shac", "sac", "steer", "horizons"])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--minutes", type=float, default=4.0)
    parser.add_argument("--folder", type=Path, default=Path("runs/gradient_control"))
    chosen = parser.parse_args()
    torch.set_num_threads(1)
    task, settings, began = Approach(), Settings(seed=chosen.seed), count_cpu_seconds()
    actor, watch = make_policy(settings), Watch(chosen.minutes)
    path = chosen.folder / f"{chosen.method}-{chosen.seed}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    if chosen.method in ("shac", "horizons"):
        swimmers = Swimmers(task, settings.num_envs, seed=settings.seed)
        swimmers.step(torch.zeros(settings.num_envs, 2))  # compiles
        swimmers.reset_(torch.ones(settings.num_envs, dtype=torch.bool))
    if chosen.method == "horizons":
        result = measure_horizons(swimmers, actor)
        weights = path.with_name(f"shac-{chosen.seed}.pt")
        if weights.exists():
            actor.load_state_dict(torch.load(weights))
            result += measure_horizons(swimmers, actor)
    elif chosen.method == "steer":
        result = evaluate(task, [steer])
    else:
        if chosen.method == "shac":
            with suppress(OutOfTime):
                train_shac(swimmers, actor, watch, settings)
        else:
            actor = train_sac(task, watch, settings)
        torch.save(actor.state_dict(), path.with_suffix(".pt"))
        policies = (load(actor, weights) for _, _, weights in watch.kept)
        result = [
            {"set_up_seconds": watch.began - began, "seconds": seconds, "frames": frames, **metrics}
            for (seconds, frames, _), metrics in zip(
                watch.kept, evaluate(task, policies), strict=True
            )
        ]
    path.write_text(json.dumps(result, indent=1))
    for row in result:
        print({name: round(value, 4) for name, value in row.items()})


if __name__ == "__main__":
    main()
