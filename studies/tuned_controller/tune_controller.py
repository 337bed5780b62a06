"""Tune hand-crafted station-holding controllers with as many decisions as learning gets.

    python examples/tune_controller.py sight
    python examples/tune_controller.py lateral_line --decisions 80000

CMA-ES adapts the numbers of a controller to the task of ``zoo/gait_bend``: of ``pid``, which knows
place and heading, or of a blind one, which knows its own motion, or its lateral line as well. The
candidates act side by side, one in each flow; the score is the return that learning maximises. The
mean of the last generation is then tried from the evaluation's starts.
"""

import argparse
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import TransformedEnv

from fishrl.envs import KarmanGait, make_env
from fishrl.envs.episodes import run_episodes
from fishrl.extras import show_install
from fishrl.modules import PID, GaitPolicy, KeepCourse
from fishrl.programs.statistics import find_share
from fishrl.training import load_plan
from fishrl.training.baselines import make_gait_policy
from fishrl.training.evaluation import FINAL_SEED, TRAIN_SEED, fixed_starts


@dataclass(frozen=True, kw_only=True)
class Budget:
    """What a search may spend.

    Args:
        decisions: of all candidates together; the generation that exceeds it is the last.
        candidates: per generation, and flows.
        starts: per generation, the same for all candidates.
        seed: of the search.
    """

    decisions: int = 20_000
    candidates: int = 16
    starts: int = 2
    seed: int = 0


class Controller(NamedTuple):
    """A hand-crafted controller with numbers to tune."""

    untuned: dict[str, float]  #: value by name
    step: dict[str, float]  #: of some: what a number adds to the value; others it scales by e
    make: Callable[[KarmanGait, Tensor], GaitPolicy]  #: from the values ``[N, B]`` of B flows

    def decode(self, numbers: Tensor) -> Tensor:
        """Return the values ``[N, B]`` for numbers ``[B, N]``, 0 for the untuned ones."""
        pairs = zip(self.untuned.items(), numbers.T, strict=True)
        values = [
            value + self.step[name] * x if name in self.step else value * x.exp()
            for (name, value), x in pairs
        ]
        return torch.stack(values)


def make_seeing(task: KarmanGait, values: Tensor) -> GaitPolicy:
    """Return ``pid``, one controller per flow."""
    station, gain, damping, course, course_damping, bend, yaw_damping = values
    policy = make_gait_policy(PID(station_bl=station, gain=gain, damping=damping), task)
    policy.course = KeepCourse(
        gain=course,
        damping=course_damping,
        bend_gain=bend,
        yaw_damping=yaw_damping,
        interval_T=task.interval_T,
    )
    return policy


class Blind:
    """Beat steadily, and keep the course by dead reckoning; answer to the lateral line at once.

    The fish starts facing upstream, so the sum of its yaw rate is its heading, and the sum of that
    tells how far aside it has swum. Bend and frequency also follow the latest signals of the
    neuromasts, linearly, with weights that a reflection leaves as they are: ``pressure`` and
    ``ahead`` bend by their difference between left and right, ``left`` by its sum.

    Args:
        values: four of own motion and, with a lateral line, those of ``LINE``, ``[N, B]``.
        task: with five neuromasts, which feel ``ahead``, ``left`` and ``pressure``.
    """

    def __init__(self, values: Tensor, task: KarmanGait) -> None:
        self.own, self.line = values[:4], values[4:]
        self.interval_T, self.unit = task.interval_T, task.max_stream_speed_bl
        self.heading = self.aside = torch.zeros(values.shape[1])

    def feel(self, tensordict: TensorDictBase) -> tuple[Tensor, Tensor]:
        """Return what bends ``[7, B]`` and what speeds up ``[5, B]``, without units."""
        signal = tensordict["lateral_line"][:, -1].double()
        nose, right, left = signal[:, 0], signal[:, 1::2], signal[:, 2::2]
        scale = signal.new_tensor((self.unit, self.unit, self.unit**2))
        odd = (left - right) / scale
        odd[..., 1] = (left + right)[..., 1] / self.unit
        even = (left + right) / scale
        bends = torch.cat((nose[:, 1:2] / self.unit, odd.flatten(1)), 1)
        speeds = torch.cat((nose[:, ::2] / scale[::2], even[..., 0], even[:, :1, 2]), 1)
        return bends.T, speeds.T

    def beat(self, tensordict: TensorDictBase, flow: Tensor) -> Tensor:
        """Return the frequency ``[B]``, beats per T."""
        frequency = self.own[0].double()
        if len(self.line):
            _, speeds = self.feel(tensordict)
            frequency = frequency + (self.line[7:] * speeds).sum(0)
        return frequency

    def bend(self, tensordict: TensorDictBase) -> Tensor:
        """Return the share of the largest bend ``[B]``, positive to the left."""
        rate = tensordict["yaw_rate"].reshape(-1)
        goes_on = ~tensordict["is_init"].reshape(-1)
        self.heading = (self.heading + self.interval_T * rate) * goes_on
        self.aside = (self.aside + self.interval_T * self.heading) * goes_on
        _, gain, damping, course = self.own
        share = -gain * self.heading - damping * rate - course * self.aside
        if len(self.line):
            bends, _ = self.feel(tensordict)
            share = share + (self.line[:7] * bends).sum(0)
        bend: Tensor = share.clamp(-1.0, 1.0).float()
        return bend


def make_blind(task: KarmanGait, values: Tensor) -> GaitPolicy:
    """Return ``Blind``, one controller per flow."""
    blind = Blind(values, task)
    policy = make_gait_policy(blind.beat, task)
    policy.course = blind.bend
    return policy


#: Untuned ``pid``; the setpoint is varied by lengths.
SIGHT = {
    "station_bl": 2.1,
    "gain": 2.0,
    "damping": 32.0,
    "course": 0.6,
    "course damping": 0.3,
    "bend": 3.0,
    "yaw damping": 0.3,
}
#: The same gains, for heading and offset by dead reckoning at 0.5 L/T.
OWN_MOTION = {"frequency": 1.0, "heading": 3.0, "yaw damping": 0.3, "course": 0.9}
#: Weights of the signals in the order of ``Blind.feel``: front and back are the pairs.
LINE = dict.fromkeys(
    (
        "bend by left, nose",
        "bend by ahead, front",
        "bend by left, front",
        "bend by pressure, front",
        "bend by ahead, back",
        "bend by left, back",
        "bend by pressure, back",
        "beat by ahead, nose",
        "beat by pressure, nose",
        "beat by ahead, front",
        "beat by ahead, back",
        "beat by pressure, front",
    ),
    0.0,
)
CONTROLLERS = {
    "sight": Controller(SIGHT, {"station_bl": 0.5}, make_seeing),
    "own_motion": Controller(OWN_MOTION, {}, make_blind),
    "lateral_line": Controller(OWN_MOTION | LINE, dict.fromkeys(LINE, 1.0), make_blind),
}


def try_all(env: TransformedEnv, policy: GaitPolicy, starts: TensorDictBase) -> tuple[Tensor, int]:
    """Return the mean return ``[B]`` of each candidate, and the decisions that it took."""
    returns, decisions = torch.zeros(env.batch_size), 0
    for start in starts.split(1):
        episodes = run_episodes(env, policy, start.expand(env.batch_size).clone())
        returns = returns + episodes.returns / len(starts)
        decisions += int(episodes.lengths.sum())
    return returns, decisions


def tune(
    controller: Controller, task: KarmanGait, budget: Budget, *, compile: bool = True
) -> Tensor:
    """Search, print each generation, and return the numbers ``[N]``."""
    try:
        import cmaes
    except ImportError as error:
        raise ImportError(f"the search needs cmaes: {show_install('sweep')}") from error
    num, mean = budget.candidates, np.zeros(len(controller.untuned))
    search = cmaes.CMA(mean=mean, sigma=0.5, population_size=num, seed=budget.seed)
    generator = torch.Generator().manual_seed(TRAIN_SEED + budget.seed)
    env, spent = make_env(task=task, num_envs=num, compile=compile), 0
    while spent < budget.decisions:
        numbers = torch.tensor(np.array([search.ask() for _ in range(num)]), dtype=torch.float32)
        starts = task.sample_starts(budget.starts, generator)
        policy = controller.make(task, controller.decode(numbers))
        scores, decisions = try_all(env, policy, starts)
        search.tell(
            [(x.double().numpy(), -float(score)) for x, score in zip(numbers, scores, strict=True)]
        )
        spent += decisions
        print(
            f"{spent} decisions: return {float(scores.mean()):.1f}, best {float(scores.max()):.1f}"
        )
    env.close()
    return torch.as_tensor(search.mean, dtype=torch.float32)


def main() -> None:
    """Tune, then try the result from 24 starts for 40 T."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("senses", choices=CONTROLLERS)
    parser.add_argument("--decisions", type=int, default=Budget.decisions)
    parser.add_argument("--seed", type=int, default=Budget.seed)
    chosen = parser.parse_args()
    task = load_plan("zoo/gait_bend").task
    assert isinstance(task, KarmanGait)
    controller = CONTROLLERS[chosen.senses]
    numbers = tune(controller, task, Budget(decisions=chosen.decisions, seed=chosen.seed))
    values = controller.decode(numbers[None])[:, 0].tolist()
    print(", ".join(f"{name} {x:.2f}" for name, x in zip(controller.untuned, values, strict=True)))
    longer = replace(task, time_limit=321)
    env = make_env(task=longer, num_envs=12)
    policy = controller.make(longer, controller.decode(numbers.expand(12, -1)))
    episodes = run_episodes(env, policy, fixed_starts(longer, 24, seed=FINAL_SEED))
    env.close()
    share = find_share(int(episodes.succeeded.sum()), 24).show(".0%")
    print(f"lasts 40 T: {share}, {episodes.metrics()['mean_length_T']:.1f} T on average")


if __name__ == "__main__":
    main()
