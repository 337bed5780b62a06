"""Tune ``pid`` for the frozen task ``station-v1``: python studies/tuned_controller/tune_station.py

CMA-ES searches seven numbers by the mean duration of training episodes: 16 candidates, each from
the same 6 new starts, in 20 generations. Its last mean is then compared with ``pid`` on the
validation starts. It needs ``cmaes``.
"""

from contextlib import closing

import cmaes
import numpy as np
import torch
from torch import Tensor

from fishrl.benchmark import find_version
from fishrl.envs import Flows, KarmanGait, make_env, make_task, run_episodes
from fishrl.training.baselines import make_pid, make_tuned_pid
from fishrl.training.evaluation import TRAIN_SEED

CANDIDATES, STARTS, GENERATIONS = 16, 6, 20
#: Numbers of ``pid``, in the order of ``TUNED``; all but the first are searched by their logarithm.
UNTUNED = {
    "station_bl": 2.1,
    "gain": 2.0,
    "damping": 32.0,
    "course gain": 0.6,
    "course damping": 0.3,
    "bend_gain": 3.0,
    "yaw_damping": 0.3,
}


def decode(numbers: Tensor) -> Tensor:
    """Return the values ``[7, B]`` for numbers ``[B, 7]``, 0 for the untuned ones."""
    untuned = torch.tensor([*UNTUNED.values()])[:, None]
    factors = untuned * numbers.T.exp()
    return torch.cat((untuned[:1] + 0.5 * numbers.T[:1], factors[1:]))


def search() -> Tensor:
    """Return the numbers ``[7]``."""
    task = make_task("station-v1")
    assert isinstance(task, KarmanGait)
    generator = torch.Generator().manual_seed(TRAIN_SEED)
    found = cmaes.CMA(mean=np.zeros(7), sigma=0.5, population_size=CANDIDATES, seed=0)
    spent = 0
    with closing(make_env(task=task, flows=Flows(num_envs=CANDIDATES * STARTS), seed=0)) as env:
        for generation in range(GENERATIONS):
            numbers = torch.tensor(np.array([found.ask() for _ in range(CANDIDATES)])).float()
            starts = task.sample_starts(STARTS, generator)
            every = starts[torch.arange(STARTS).repeat(CANDIDATES)]
            policy = make_tuned_pid(task, numbers=decode(numbers).repeat_interleave(STARTS, 1))
            episodes = run_episodes(env, policy, every)
            lengths = (episodes.lengths * episodes.interval_T).view(CANDIDATES, STARTS).mean(1)
            pairs = zip(numbers.double().numpy(), lengths.tolist(), strict=True)
            found.tell([(x, -length) for x, length in pairs])
            spent += int(episodes.lengths.sum())
            mean, best = float(lengths.mean()), float(lengths.max())
            print(f"{generation} {spent} decisions: {mean:.1f} T, best {best:.1f}", flush=True)
    return torch.as_tensor(found.mean, dtype=torch.float32)


def main() -> None:
    """Tune, and try the result and ``pid`` on the validation starts."""
    values = decode(search()[None])
    print(dict(zip(UNTUNED, [round(float(x), 4) for x in values[:, 0]], strict=True)))
    task, starts = find_version("station-v1").hold_out("validation")
    assert isinstance(task, KarmanGait)
    with closing(make_env(task=task, flows=Flows(num_envs=len(starts)), seed=0)) as env:
        for name, policy in (
            ("tuned", make_tuned_pid(task, numbers=values.expand(-1, len(starts)))),
            ("pid", make_pid(task)),
        ):
            episodes = run_episodes(env, policy, starts)
            print(name, episodes.metrics()["mean_length_T"], episodes.metrics()["success_rate"])


if __name__ == "__main__":
    main()
