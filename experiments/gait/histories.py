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


class Histories(NamedTuple):
    """E episodes of up to N decisions, with M frames in each; NaN after an episode's end.

    Attributes:
        flow: ``[E]`` index of the flow.
        place: ``[E, N + 1, 2]`` of the nose (x downstream, y), body lengths, from the start on.
        frequency: ``[E, N]`` beats per T of each interval.
        named: ``[E, N]`` flow label given to the policy at the decision; NaN without one.
        angle_of_attack: ``[E, N]`` at its end, radians.
        work: ``[E, N + 1]`` done since the start by all forces, rho L^2 (L / T)^2.
        positive_work: ``[E, N + 1]`` the same where no marker gives back what the flow does on it.
        lateral_work: ``[E, N + 1]`` the paper's form.
        lengths_T: ``[E]`` duration of the episode, also within its last interval.
        terminated: ``[E]`` bool, whether it left the safe area.
        diverged: ``[E]`` bool.
        beat: ``[E, N M]`` phase of the tail beat at the end of each frame, radians.
        aside: ``[E, N M]`` y of the nose, body lengths.
        lift: ``[E, N M]`` mean lift on the obstacle within each frame, rho (L / T)^2 L; zero
            without one.
    """

    flow: Tensor
    place: Tensor
    frequency: Tensor
    named: Tensor
    angle_of_attack: Tensor
    work: Tensor
    positive_work: Tensor
    lateral_work: Tensor
    lengths_T: Tensor
    terminated: Tensor
    diverged: Tensor
    beat: Tensor
    aside: Tensor
    lift: Tensor


def pick(histories: Histories, rows: Tensor) -> Histories:
    """Return some of the episodes; ``rows`` is a mask ``[E]``."""
    return Histories(*(value[rows] for value in histories))


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


_PLACES = ("place", "work", "positive_work", "lateral_work")
_FRAMES = ("beat", "aside", "lift")


def record_histories(
    env: TransformedEnv,
    policy: Callable[[TensorDictBase], TensorDictBase],
    starts: TensorDictBase,
    *,
    num_decisions: int,
    samples_actions: bool = False,
    on_decision: Callable[[], None] | None = None,
) -> Histories:
    """Run one episode from each start, all side by side.

    Args:
        env: of ``KarmanGait``, with as many flows as there are starts; its ``frames_per_action``
            is M.
        policy: writes ``action``.
        starts: ``[E]``.
        num_decisions: N, after which episodes are left.
        samples_actions: sample the actions of a learned policy with torch's global generator, as
            in training; otherwise it acts greedily.
        on_decision: called after each.

    Raises:
        ValueError: if the env has not one flow per start.
    """
    base, num = env.base_env, starts.shape[0]
    if base.batch_size[0] != num:
        raise ValueError(f"{num} starts in {base.batch_size[0]} flows: give one flow per start")
    kept: dict[str, list[Tensor]] = {}
    frames = _FrameRecorder(kept)
    ages = torch.zeros(num, device=base.device)

    def begin(start_of: Tensor, state: TensorDictBase) -> None:
        frames.begin(base.solver)
        _keep(kept, start_of >= 0, {name: base.now[name] for name in _PLACES})

    def note(start_of: Tensor, step: TensorDictBase) -> None:
        is_open = start_of >= 0
        named = step.get("flow_class", torch.full_like(ages, torch.nan))
        ages.copy_(torch.where(is_open, base.now["age"].to(ages), ages))
        now = {name: base.now[name] for name in (*_PLACES, "frequency")}
        now["angle_of_attack"] = base.now["heading"] - torch.pi
        now["named"] = named.reshape(num).double()
        _keep(kept, is_open, now)
        if on_decision is not None:
            on_decision()

    episodes = run_episodes(
        env,
        policy,
        starts,
        max_decisions=num_decisions,
        exploration=ExplorationType.RANDOM if samples_actions else ExplorationType.DETERMINISTIC,
        on_begin=begin,
        on_step=note,
        on_frame=frames.keep,
    )
    task = base.task
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


class _FrameRecorder:
    """Keeps beat, place and lift several times within an action."""

    def __init__(self, kept: dict[str, list[Tensor]]) -> None:
        self._kept = kept

    def begin(self, solver: Any) -> None:
        """Begin new episodes in all rows."""
        self._before = _read_impulse(solver)

    def keep(self, start_of: Tensor, base: Any) -> None:
        """Keep a frame of the rows that run; the env calls this."""
        solver, task = base.solver, base.task
        impulse, age = _read_impulse(solver)
        unit = task.body_length * (task.body_length / task.scales.period) ** 2
        steps = (age - self._before[1]).clamp_min(1.0)
        values = {
            "beat": solver.body.phase,
            "aside": (solver.head()[:, 1] - task.origin[1].to(age)) / task.body_length,
            "lift": (impulse - self._before[0]) / steps / unit,
        }
        self._before = impulse, age
        _keep(self._kept, start_of >= 0, values)


def _read_impulse(solver: Any) -> tuple[Tensor, Tensor]:
    """Return the lateral impulse on the obstacle ``[B]`` and the age ``[B]`` of the flows."""
    bodies = solver.bodies
    age = bodies[0].age.clone()
    lift = bodies[1].impulse[:, 1].clone() if len(bodies) > 1 else torch.zeros_like(age)
    return lift, age


def _keep(kept: dict[str, list[Tensor]], is_open: Tensor, values: dict[str, Tensor]) -> None:
    for name, value in values.items():
        rows = is_open.view(-1, *(1,) * (value.dim() - 1))
        kept.setdefault(name, []).append(torch.where(rows, value, torch.nan))
