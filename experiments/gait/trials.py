"""Trials: one policy in every flow, from the same starts; histories are kept in files."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import torch
from omegaconf import MISSING
from tensordict import TensorDict
from torchrl.envs import TransformedEnv

from experiments.gait.histories import Histories, record_histories
from fishrl.bounds import check_bounds
from fishrl.envs import KarmanGait, make_env
from fishrl.envs.macro_actions import DirectFrequencies
from fishrl.envs.steering import PolicySteering
from fishrl.envs.transforms import ORACLE, equip
from fishrl.files import load_tensors, staged
from fishrl.modules import FixedFrequency, LateralLineClassifier
from fishrl.physics.cache_key import hash_sources, make_key
from fishrl.training.baselines import make_baseline, make_gait_policy
from fishrl.training.classifier import find_classifier, load_recognition
from fishrl.training.policies import load_plan, load_policy
from fishrl.training.progress import Progress

#: Duration of a trial in T, whatever the length of the training episodes.
PERIODS = 100.0
#: Initial position of the nose, whatever it was in training; body lengths.
START_X_BL, START_Y_BL = (1.5, 2.0), (-0.1, 0.1)
#: Frames within an action, for phases and oscillations.
FRAMES = 8
_SOURCES = (
    "fishrl.envs",
    "fishrl.modules",
    "fishrl.training.baselines",
    "experiments.gait.histories",
)


@dataclass(kw_only=True)
class GaitSettings:
    """Settings shared by the programs of the Kármán gait study.

    Args:
        task: the task, with streams, body and safe area.
        preset: name of a preset; only its task is used.
    """

    task: Any = MISSING
    preset: str | None = None

    def __post_init__(self) -> None:
        """Check the bounds."""
        check_bounds(self)


@dataclass(frozen=True, kw_only=True)
class Trial:
    """A policy to try in every flow.

    Args:
        name: of the policy, for tables; trials of one ``arm`` differ in their seed.
        arm: kind of policy.
        trained: task of the policy.
        make_policy: creates it.
        identity: what determines its behaviour besides the task, as text.
        recognition: gives it flow labels, see ``make_env``.
        periods: duration in T; rounded up to whole decisions.
    """

    name: str
    arm: str
    trained: KarmanGait
    make_policy: Callable[[], Any]
    identity: str
    recognition: LateralLineClassifier | str | None = None
    periods: float = PERIODS

    @property
    def task(self) -> KarmanGait:
        """The task of the trial: all flows, fixed starts."""
        task = self.trained
        return replace(
            task,
            start_flows=tuple(range(len(task.stream.speeds_bl))),
            time_limit=math.ceil(self.periods / task.interval_T - 1e-9),
            start_x_bl=START_X_BL,
            start_y_bl=START_Y_BL,
        )

    def make_env(self, *, num_envs: int, seed: int) -> TransformedEnv:
        """Return the environment of the trial."""
        return make_env(
            task=self.task,
            num_envs=num_envs,
            seed=seed,
            frames_per_action=FRAMES,
            recognition=self.recognition,
        )


def load_trial(run: Path, *, periods: float = PERIODS) -> Trial:
    """Return the trial of the learned policy of a run folder.

    Raises:
        ValueError: if there is none, or it has another task.
    """
    path, plan = load_plan(run)
    choice = find_classifier(plan.recognition, path)
    recognition = load_recognition(choice)
    task, _ = equip(plan.task, recognition)
    if not isinstance(task, KarmanGait):
        raise ValueError(f"{run}: a policy of {type(task).__name__}; give runs of task=karman_gait")
    files = sorted(path.rglob("*-actor/*"))
    if isinstance(recognition, LateralLineClassifier):
        files.append(Path(str(choice)))
    return Trial(
        name=run.name,
        arm=name_arm(task, plan.recognition),
        trained=task,
        recognition=recognition,
        make_policy=partial(load_policy, path, task=task, has_labels=recognition is not None),
        identity=make_key(*(file.read_bytes() for file in files)),
        periods=periods,
    )


def name_arm(task: KarmanGait, recognition: str | None) -> str:
    """Name the kind of a learned policy."""
    if isinstance(task.control, DirectFrequencies):
        return "ablation" if recognition is None else "lateral line alone"
    return {None: "true row, unlabelled", ORACLE: "oracle"}.get(recognition, "both modules")


def make_trial(name: str, task: KarmanGait, *, periods: float = PERIODS) -> Trial:
    """Return the trial of a baseline, which is given the true flow label.

    Args:
        name: as for ``make_baseline``; or ``passive``, ``shedding`` (the shedding frequency of each
            flow) or ``fixed-0.6`` (0.6 beats per T), whatever the rows of the task; with
            ``+policy`` appended, the learned heading controller steers.
        task: of the others.
        periods: see ``Trial``.

    Raises:
        ValueError: for an unknown name.
    """
    task = replace(task, reads_flow_class=False)
    kind, _, steering = name.partition("+")
    if steering not in ("", "policy"):
        raise ValueError(f"baseline {name!r}: the only suffix is +policy")
    if steering:
        per_T = max(1, round(1.0 / task.interval_T))
        task = replace(task, steering=PolicySteering(decisions_per_T=per_T))
    rates, make_policy = _find_rates(kind, task), partial(make_baseline, kind, task=task, seed=0)
    if rates is not None:
        # the highest frequency stays in the row: it determines T, and so the flow
        row = tuple(sorted({0.0, *rates, task.control.max_frequency}))
        if row[-1] > task.control.max_frequency:
            raise ValueError(f"baseline {name!r}: at most {task.control.max_frequency} beats per T")
        task = replace(task, control=DirectFrequencies(frequencies=row, first_gear=0))
        controller = FixedFrequency(rates if len(rates) > 1 else rates[0])
        make_policy = partial(make_gait_policy, controller, task)
    return Trial(
        name=name, arm=name, trained=task, make_policy=make_policy, identity=name, periods=periods
    )


def _find_rates(kind: str, task: KarmanGait) -> Sequence[float] | None:
    """Return the constant frequencies of a baseline, one or one per flow; None if they vary."""
    if kind == "passive":
        return [0.0]
    if kind == "shedding":
        if task.wakes is None:
            raise ValueError("baseline shedding: there is no vortex shedding in a free stream")
        return list_shedding(task)
    word, _, rate = kind.partition("-")
    return [float(rate)] if word == "fixed" else None


def list_shedding(task: KarmanGait) -> list[float]:
    """Return the shedding frequency of each flow, per T; NaN in free streams."""
    if task.wakes is None:
        return [math.nan] * len(task.stream.speeds_bl)
    frequencies: list[float] = (task.wakes.shedding_frequencies * task.scales.period).tolist()
    return frequencies


def run_trial(
    trial: Trial,
    *,
    episodes: int,
    folder: Path,
    samples_actions: bool = False,
    seed: int = 0,
    progress: Progress | None = None,
) -> Histories:
    """Run ``episodes`` from fixed starts in every flow, or read them from the folder if it can.

    The starts of a seed are the same for every policy; ``samples_actions`` as for
    ``record_histories``.
    """
    task, sources = trial.task, hash_sources(*_SOURCES)
    key = make_key(task, trial.identity, episodes, samples_actions, seed, FRAMES, sources)
    path = folder / f"{trial.name}-{key}.pt"
    if path.is_file():
        return Histories(**load_tensors(path, what="histories", remedy="delete the file"))
    flows = len(task.stream.speeds_bl)
    starts: TensorDict = task.sample_starts(flows * episodes, torch.Generator().manual_seed(seed))
    # the same noses, phases and keys in each flow
    starts = torch.cat([starts[:episodes]] * flows)
    starts["flow_index"] = torch.arange(flows).repeat_interleave(episodes)
    env = trial.make_env(num_envs=len(starts), seed=seed)
    torch.manual_seed(seed)
    histories = record_histories(
        env,
        trial.make_policy(),
        starts,
        num_decisions=task.time_limit,
        samples_actions=samples_actions,
        progress=progress,
        label=trial.name,
    )
    folder.mkdir(parents=True, exist_ok=True)
    with staged(path) as stage:
        torch.save(histories._asdict(), stage)
    return histories
