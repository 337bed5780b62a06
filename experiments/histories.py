"""What fish did, decision by decision: the numbers behind the figures of the Kármán gait."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase
from torchrl.envs.utils import ExplorationType, set_exploration_type


class Histories(NamedTuple):
    """E episodes of up to N decisions; NaN after an episode's end.

    Attributes:
        flow: ``[E]`` which flow it was.
        place: ``[E, N + 1, 2]`` of the nose (x downstream, y), body lengths, from the start on.
        frequency: ``[E, N]`` beats per T of each interval.
        angle_of_attack: ``[E, N]`` at its end, radians.
        work: ``[E, N + 1]`` done since the start, rho L^2 (L / T)^2.
        lengths_T: ``[E]`` duration of the episode; up to N decisions.
        terminated: ``[E]`` bool, whether it ended in danger.
        diverged: ``[E]`` bool.
    """

    flow: Tensor
    place: Tensor
    frequency: Tensor
    angle_of_attack: Tensor
    work: Tensor
    lengths_T: Tensor
    terminated: Tensor
    diverged: Tensor


def record_histories(
    env: EnvBase,
    policy: Callable[[TensorDictBase], TensorDictBase],
    starts: TensorDictBase,
    *,
    num_decisions: int,
    on_decision: Callable[[], None] | None = None,
) -> Histories:
    """Run one episode from each start, all side by side.

    Args:
        env: of ``KarmanGait``, with as many flows as there are starts.
        policy: writes ``action``; a learned one acts greedily.
        starts: ``[E]``.
        num_decisions: N, after which episodes are left.
        on_decision: called after each.

    Raises:
        ValueError: if the env has not one flow per start.
    """
    base, num = env.base_env, starts.shape[0]
    if base.batch_size[0] != num:
        raise ValueError(f"{num} starts in {base.batch_size[0]} flows: give one flow per start")
    before, base.starts, base._next_start = base.starts, starts, 0
    names = ("place", "frequency", "angle_of_attack", "work")
    kept: dict[str, list[Tensor]] = {name: [] for name in names}
    is_open = torch.ones(num, dtype=torch.bool, device=base.device)
    lengths, terminated, diverged = (torch.zeros(num, device=base.device) for _ in range(3))
    try:
        with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
            state = env.reset()
            _keep(kept, base.now, is_open)
            for _ in range(num_decisions):
                base.is_resting = ~is_open
                after = env.step(policy(state))["next"]
                lengths += is_open
                _keep(kept, base.now, is_open)
                for total, flag in ((terminated, "terminated"), (diverged, "diverged")):
                    total += is_open & after[flag].squeeze(-1)
                is_open = is_open & ~after["done"].squeeze(-1)
                if on_decision is not None:
                    on_decision()
                if not is_open.any():
                    break
                state = after.exclude("reward", "done", "terminated", "truncated")
    finally:
        base.starts, base.is_resting = before, torch.zeros_like(is_open)
    task = base.task
    series = {name: torch.stack(values, 1).cpu() for name, values in kept.items()}
    return Histories(
        flow=starts["flow_index"].cpu(),
        place=series["place"],
        frequency=series["frequency"][:, 1:],
        angle_of_attack=series["angle_of_attack"][:, 1:],
        work=series["work"],
        lengths_T=lengths.cpu() * task.n_substeps / task.scales.period,
        terminated=terminated.bool().cpu(),
        diverged=diverged.bool().cpu(),
    )


def _keep(kept: dict[str, list[Tensor]], now: TensorDictBase, is_open: Tensor) -> None:
    values = {
        "place": now["place"],
        "frequency": now["frequency"],
        "angle_of_attack": now["heading"] - torch.pi,
        "work": now["work"],
    }
    for name, value in values.items():
        rows = is_open.view(-1, *(1,) * (value.dim() - 1))
        kept[name].append(torch.where(rows, value, torch.nan))
