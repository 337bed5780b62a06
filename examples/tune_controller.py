"""Tune the hand-crafted station-holding controller with as many decisions as learning gets.

    python examples/tune_controller.py

CMA-ES adapts seven numbers of the controller ``pid``, which turns by bending, to the task of
``zoo/gait_bend``. Its candidates act side by side, one in each flow; the score is the return that
learning maximises. The mean of the last generation is then tried from the evaluation's starts.
"""

import argparse
from dataclasses import dataclass, replace

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
from fishrl.training.baselines import make_gait_policy
from fishrl.training.evaluation import FINAL_SEED, TRAIN_SEED, fixed_starts
from fishrl.zoo import load_policy

#: Untuned values of ``pid``; the setpoint, which is varied by lengths, the others by factors.
NAMES = ("station_bl", "gain", "damping", "course", "course damping", "bend", "yaw damping")
UNTUNED = torch.tensor([2.1, 2.0, 32.0, 0.6, 0.3, 3.0, 0.3])


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


def decode(numbers: Tensor) -> Tensor:
    """Return the controller's values ``[7, B]`` for numbers ``[B, 7]``, 0 for the untuned ones."""
    station, *others = numbers.T
    values = [UNTUNED[0] + 0.5 * station]
    values += [value * x.exp() for value, x in zip(UNTUNED[1:], others, strict=True)]
    return torch.stack(values)


def make_controller(task: KarmanGait, values: Tensor) -> GaitPolicy:
    """Return one controller per flow from its values ``[7, B]``."""
    policy = make_gait_policy(PID(), task)
    station, gain, damping, course, course_damping, bend, yaw_damping = values
    policy.controller = PID(station_bl=station, gain=gain, damping=damping)
    policy.course = KeepCourse(
        gain=course,
        damping=course_damping,
        bend_gain=bend,
        yaw_damping=yaw_damping,
        interval_T=task.interval_T,
    )
    return policy


def try_all(
    env: TransformedEnv, task: KarmanGait, numbers: Tensor, starts: TensorDictBase
) -> tuple[Tensor, int]:
    """Return the mean return ``[B]`` of each candidate, and the decisions that it took."""
    policy, returns, decisions = make_controller(task, decode(numbers)), 0.0, 0
    for start in starts.split(1):
        episodes = run_episodes(env, policy, start.expand(len(numbers)).clone())
        returns = returns + episodes.returns.double() / len(starts)
        decisions += int(episodes.lengths.sum())
    return torch.as_tensor(returns), decisions


def tune(task: KarmanGait, budget: Budget, *, compile: bool = True) -> Tensor:
    """Search, print each generation, and return the numbers ``[7]``."""
    try:
        import cmaes
    except ImportError as error:
        raise ImportError(f"the search needs cmaes: {show_install('sweep')}") from error
    num = budget.candidates
    search = cmaes.CMA(mean=np.zeros(7), sigma=0.5, population_size=num, seed=budget.seed)
    generator = torch.Generator().manual_seed(TRAIN_SEED + budget.seed)
    env, spent = make_env(task=task, num_envs=num, compile=compile), 0
    while spent < budget.decisions:
        numbers = torch.tensor(np.array([search.ask() for _ in range(num)]), dtype=torch.float32)
        starts = task.sample_starts(budget.starts, generator)
        scores, decisions = try_all(env, task, numbers, starts)
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
    parser.add_argument("--decisions", type=int, default=Budget.decisions)
    parser.add_argument("--seed", type=int, default=Budget.seed)
    chosen = parser.parse_args()
    _, task = load_policy("gait_bend")
    assert isinstance(task, KarmanGait)
    numbers = tune(task, Budget(decisions=chosen.decisions, seed=chosen.seed))
    values = decode(numbers[None])[:, 0].tolist()
    print(", ".join(f"{name} {value:.2f}" for name, value in zip(NAMES, values, strict=True)))
    longer = replace(task, time_limit=321)
    env = make_env(task=longer, num_envs=12)
    policy = make_controller(longer, decode(numbers.expand(12, 7)))
    episodes = run_episodes(env, policy, fixed_starts(longer, 24, seed=FINAL_SEED))
    env.close()
    share = find_share(int(episodes.succeeded.sum()), 24).show(".0%")
    print(f"lasts 40 T: {share}, {episodes.metrics()['mean_length_T']:.1f} T on average")


if __name__ == "__main__":
    main()
