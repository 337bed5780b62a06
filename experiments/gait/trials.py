"""Trials: one fish in every flow, from the same starts; kept in files, run once."""

from __future__ import annotations

import hashlib
import logging
import math
import os
import pickle
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDict

import experiments.gait.histories as histories_module
import fishrl.envs
import fishrl.modules
from experiments.config import build
from experiments.gait.histories import Histories, record_histories
from experiments.settings import ConfigError
from fishrl.envs import KarmanGait, make_env
from fishrl.envs.macro_actions import DirectFrequencies
from fishrl.envs.steering import PolicySteering
from fishrl.modules import FixedFrequency
from fishrl.physics.cache_key import hash_sources
from fishrl.training import baselines
from fishrl.training.baselines import load_policy, make_gait_policy, make_policy
from fishrl.training.checkpoint import read_metadata
from fishrl.training.progress import Progress
from fishrl.training.recognition import ORACLE, Recognition, find_machine

logger = logging.getLogger(__name__)

#: How long a trial lasts, however short the episodes in which a fish learned; T.
PERIODS = 100.0
#: Where the nose is at first, wherever a fish began while it learned; body lengths.
STARTS = {"start_x_bl": (1.5, 2.0), "start_y_bl": (-0.1, 0.1)}
#: Frames within an action: what phases and swings are measured by.
FRAMES = 8


@dataclass(frozen=True, kw_only=True)
class Trial:
    """A fish to try.

    Args:
        name: of it, for tables; trials of one ``arm`` differ in their seed.
        arm: what kind of fish it is.
        recognition: its task, and who tells it which flow it is in.
        make_policy: makes its brain.
        identity: what shapes its behaviour beside the task, as text.
        periods: how long it is tried, T; rounded up to whole decisions.
    """

    name: str
    arm: str
    recognition: Recognition
    make_policy: Callable[[], Any]
    identity: str
    periods: float = PERIODS

    @property
    def task(self) -> KarmanGait:
        """What it does; in all flows, from the same starts."""
        task = self.recognition.task
        return replace(
            task,
            start_flows=tuple(range(len(task.stream.speeds_bl))),
            time_limit=math.ceil(self.periods / task.interval_T - 1e-9),
            **STARTS,
        )


def load_trial(run: Path, *, periods: float = PERIODS) -> Trial:
    """Take the learned fish of a run folder.

    Args:
        run: the folder.
        periods: see ``Trial``.

    Raises:
        ValueError: if there is none, or it does not hold a station.
    """
    path, metadata = read_metadata(str(run))
    config = metadata["config"]
    choice = find_machine(config.get("recognition"), path)
    recognition = Recognition(build(config["task"]), choice)
    task, weights = recognition.task, sorted(path.rglob("*-actor/*"))
    if not isinstance(task, KarmanGait):
        raise ValueError(f"{run}: a fish of {type(task).__name__}; give runs of task=karman_gait")
    return Trial(
        name=run.name,
        arm=name_arm(task, config.get("recognition")),
        recognition=recognition,
        make_policy=lambda: load_policy(
            str(path), task=task, num_told=recognition.num_told, device="cpu"
        ),
        identity=_hash_files(*weights, *([] if choice in (None, ORACLE) else [Path(choice)])),
        periods=periods,
    )


def name_arm(task: KarmanGait, recognition: str | None) -> str:
    """Name the kind of a learned fish."""
    if isinstance(task.control, DirectFrequencies):
        return "ablation" if recognition is None else "lateral line alone"
    return {None: "true row, untold", "oracle": "oracle"}.get(recognition, "both modules")


def hand_written(name: str, task: KarmanGait, *, periods: float = PERIODS) -> Trial:
    """Take a hand-written fish, which is told the true flow.

    Args:
        name: as for ``make_policy``, or ``fixed-0.6``, which beats 0.6 times per T whatever comes;
            with ``+policy`` behind it, the learned helmsman steers.
        task: of the others.
        periods: see ``Trial``.
    """
    task = replace(task, reads_flow_class=False)
    kind, _, helmsman = name.partition("+")
    if helmsman not in ("", "policy"):
        raise ValueError(f"fish {name!r}: behind the + may stand policy")
    if helmsman:
        per_T = max(1, round(1.0 / task.interval_T))
        task = replace(task, steering=PolicySteering(decisions_per_T=per_T))
    rates = _find_rates(kind, task)
    if rates is not None:
        # the fastest beat stays among them: it sets T, and so the flow
        known = sorted({0.0, *rates, task.control.max_frequency})
        if known[-1] > task.control.max_frequency:
            raise ConfigError(f"fish {name!r}: at most {task.control.max_frequency} beats per T")
        task = replace(task, control=DirectFrequencies(frequencies=tuple(known), first_gear=0))
    return Trial(
        name=name,
        arm=name,
        recognition=Recognition(task, None),
        make_policy=lambda: (
            make_gait_policy(FixedFrequency(rates if len(rates) > 1 else rates[0]), task)
            if rates is not None
            else make_policy(kind, task=task, seed=0)
        ),
        identity=name,
        periods=periods,
    )


def _find_rates(kind: str, task: KarmanGait) -> list[float] | None:
    """Return the rates that a fish beats at, one or one per flow; None if it chooses."""
    word, _, rate = kind.partition("-")
    if word == "fixed":
        try:
            return [float(rate)]
        except ValueError:
            raise ConfigError(f"fish {kind!r}: give beats per T, such as fixed-0.6") from None
    if kind == "passive":
        return [0.0]
    if kind == "shedding":
        if task.wakes is None:
            raise ConfigError("shedding: in a free stream no vortices are shed")
        return (task.wakes.shedding_frequencies * task.scales.period).tolist()  # type: ignore[no-any-return]
    return None


def run_trial(
    trial: Trial,
    *,
    episodes: int,
    folder: Path,
    samples_actions: bool = False,
    seed: int = 0,
    progress: Progress | None = None,
) -> Histories:
    """Run a fish from fixed starts in every flow, or read what it did before.

    Args:
        trial: the fish.
        episodes: in each flow.
        folder: where histories are kept, in a file for each trial.
        samples_actions: see ``record_histories``.
        seed: of the starts, the same for every fish, and of sampled actions.
        progress: the bar.
    """
    task = trial.task
    num_decisions = task.time_limit
    settings = (episodes, samples_actions, seed, FRAMES)
    words = (repr(task), trial.identity, settings, hash_behaviour())
    key = hashlib.sha256("\0".join(map(str, words)).encode()).hexdigest()[:16]
    path = folder / f"{trial.name}-{key}.pt"
    if path.is_file():
        return _read(path)
    flows = len(task.stream.speeds_bl)
    starts: TensorDict = task.sample_starts(flows * episodes, torch.Generator().manual_seed(seed))
    # the same noses, phases and keys in each flow
    starts = torch.cat([starts[:episodes]] * flows)
    starts["flow_index"] = torch.arange(flows).repeat_interleave(episodes)
    env = trial.recognition.equip(make_env)(
        task=task, num_envs=len(starts), seed=seed, starts=starts, frames_per_action=FRAMES
    )
    torch.manual_seed(seed)
    progress = progress or Progress(is_shown=False)
    progress.start(trial.name, total=num_decisions)
    histories = record_histories(
        env,
        trial.make_policy(),
        starts,
        num_decisions=num_decisions,
        samples_actions=samples_actions,
        on_decision=lambda: progress.advance(1),
    )
    env.close()
    folder.mkdir(parents=True, exist_ok=True)
    stage = path.with_suffix(f".{os.getpid()}.stage")
    torch.save(histories._asdict(), stage)
    stage.replace(path)
    return histories


def hash_behaviour() -> str:
    """Return a word that changes when the flow, the environment or a fish's code may act otherwise.

    The weights of the learned helmsman are among it.
    """
    folders = [Path(str(package.__file__)).parent for package in (fishrl.envs, fishrl.modules)]
    files = [file for folder in folders for file in sorted(folder.rglob("*")) if file.is_file()]
    files += [Path(str(baselines.__file__)), Path(str(histories_module.__file__))]
    digest = hashlib.sha256(hash_sources().encode())
    for file in files:
        if file.suffix in (".py", ".pt"):
            digest.update(file.read_bytes())
    return digest.hexdigest()


def _hash_files(*files: Path) -> str:
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()


def _read(path: Path) -> Histories:
    try:
        content: Mapping[str, Any] = torch.load(path, weights_only=True)
        return Histories(**content)
    except (OSError, RuntimeError, EOFError, TypeError, pickle.UnpicklingError) as error:
        raise ValueError(f"histories {path}: cannot be read; delete the file") from error
