"""Histories of episodes of station holding, decision by decision."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torch.nn.functional import pad
from torchrl.envs import TransformedEnv
from torchrl.envs.utils import ExplorationType

from fishrl.envs.episodes import run_episodes
from fishrl.training.progress import Progress


class Histories(NamedTuple):
    """E episodes of up to N decisions, with M frames in each; NaN after an episode's end."""

    flow: Tensor  #: [E] index of the flow
    place: Tensor  #: [E, N + 1, 2] nose (x downstream, y) from the start on, body lengths
    frequency: Tensor  #: [E, N] beats per T of each interval
    named: Tensor  #: [E, N] flow label given to the policy at the decision; NaN without one
    angle_of_attack: Tensor  #: [E, N] at the end of the interval, radians
    work: Tensor  #: [E, N + 1] done since the start by all forces, rho L^2 (L / T)^2
    positive_work: Tensor  #: [E, N + 1] where no marker gives back what the flow does on it
    lateral_work: Tensor  #: [E, N + 1] in the paper's form
    lengths_T: Tensor  #: [E] duration of the episode, also within its last interval
    terminated: Tensor  #: [E] bool, whether it left the safe area
    diverged: Tensor  #: [E] bool
    beat: Tensor  #: [E, N M] phase of the tail beat at the end of each frame, radians
    aside: Tensor  #: [E, N M] y of the nose, body lengths
    lift: Tensor  #: [E, N M] mean on the obstacle within each frame, rho (L / T)^2 L; 0 without one


_PLACES = ("place", "work", "positive_work", "lateral_work")
_FRAMES = ("beat", "aside", "lift")


def pick(histories: Histories, rows: Tensor) -> Histories:
    """Return some of the episodes; ``rows`` is a mask ``[E]``."""
    return Histories(*(value[rows] for value in histories))


def split_flows(histories: Histories, num_flows: int) -> list[Histories]:
    """Return the episodes of each flow."""
    return [pick(histories, histories.flow == flow) for flow in range(num_flows)]


def stack(parts: Sequence[Histories]) -> Histories:
    """Concatenate episodes of several recordings; shorter ones are padded with NaN."""
    return Histories(*(_concatenate(values) for values in zip(*parts, strict=True)))


def _concatenate(values: Sequence[Tensor]) -> Tensor:
    if values[0].dim() == 1:
        return torch.cat(list(values))
    length = max(value.shape[1] for value in values)
    sides = (0, 0) * (values[0].dim() - 2)
    return torch.cat(
        [pad(value, (*sides, 0, length - value.shape[1]), value=torch.nan) for value in values]
    )


def record_histories(
    env: TransformedEnv,
    policy: Callable[[TensorDictBase], TensorDictBase],
    starts: TensorDictBase,
    *,
    num_decisions: int,
    samples_actions: bool = False,
    progress: Progress | None = None,
    label: str = "episodes",
) -> Histories:
    """Run one episode from each start, all side by side, and close the environment.

    Args:
        env: of ``KarmanGait``, with as many flows as there are starts; its ``frames_per_action``
            is M.
        policy: writes ``action``.
        starts: ``[E]``.
        num_decisions: N, after which episodes are left.
        samples_actions: sample the actions of a learned policy with torch's global generator, as
            in training; otherwise it acts greedily.
        progress: progress bar, which begins with ``label``.
        label: see ``progress``.

    Raises:
        ValueError: if the env has not one flow per start.
    """
    base, task, num = env.base_env, env.base_env.task, starts.shape[0]
    if base.batch_size[0] != num:
        raise ValueError(f"{num} starts in {base.batch_size[0]} flows: give one flow per start")
    progress = progress or Progress(is_shown=False)
    progress.start(label, total=num_decisions)
    kept: dict[str, list[Tensor]] = {}
    ages = torch.zeros(num, device=base.device)
    before = _read_impulse(base.solver)

    def keep(start_of: Tensor, values: dict[str, Tensor]) -> None:
        for name, value in values.items():
            rows = (start_of >= 0).view(-1, *(1,) * (value.dim() - 1))
            kept.setdefault(name, []).append(torch.where(rows, value, torch.nan))

    def note_start(start_of: Tensor, state: TensorDictBase) -> None:
        nonlocal before
        before = _read_impulse(base.solver)
        keep(start_of, {name: base.now[name] for name in _PLACES})

    def note_decision(start_of: Tensor, step: TensorDictBase) -> None:
        named = step.get("flow_class", torch.full_like(ages, torch.nan))
        ages.copy_(torch.where(start_of >= 0, base.now["age"].to(ages), ages))
        now = {name: base.now[name] for name in (*_PLACES, "frequency")}
        now["angle_of_attack"] = base.now["heading"] - torch.pi
        now["named"] = named.reshape(num).double()
        keep(start_of, now)
        progress.advance(1)

    def note_frame(start_of: Tensor, _: Any) -> None:
        nonlocal before
        (lift, age), (earlier_lift, earlier_age) = _read_impulse(base.solver), before
        unit = task.body_length * (task.body_length / task.scales.period) ** 2
        head = base.solver.head()[:, 1]
        frame = {
            "beat": base.solver.body.phase,
            "aside": (head - task.origin[1].to(age)) / task.body_length,
            "lift": (lift - earlier_lift) / (age - earlier_age).clamp_min(1.0) / unit,
        }
        before = lift, age
        keep(start_of, frame)

    episodes = run_episodes(
        env,
        policy,
        starts,
        max_decisions=num_decisions,
        exploration=ExplorationType.RANDOM if samples_actions else ExplorationType.DETERMINISTIC,
        on_begin=note_start,
        on_step=note_decision,
        on_frame=note_frame,
    )
    env.close()
    lengths_T = ages.cpu() / task.scales.period
    series = {name: torch.stack(values, 1).cpu() for name, values in kept.items()}
    decisions = series["frequency"].shape[1]
    for name in _FRAMES:  # after an end within an interval the flow stands still
        count = series[name].shape[1]
        time = torch.arange(1, count + 1) * (task.interval_T * decisions / count)
        series[name] = series[name].masked_fill(time > lengths_T[:, None] + 1e-6, torch.nan)
    return Histories(
        flow=starts["flow_index"].cpu(),
        lengths_T=lengths_T,
        terminated=episodes.terminated,
        diverged=episodes.diverged,
        **series,
    )


def _read_impulse(solver: Any) -> tuple[Tensor, Tensor]:
    """Return the lateral impulse on the obstacle ``[B]`` and the age ``[B]`` of the flows."""
    bodies = solver.bodies
    age = bodies[0].age.clone()
    lift = bodies[1].impulse[:, 1].clone() if len(bodies) > 1 else torch.zeros_like(age)
    return lift, age
