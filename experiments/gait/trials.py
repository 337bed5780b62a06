"""Trials: one policy in every flow, from the same starts; histories are kept in files."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from fishrl.envs import Flows, KarmanGait, Oracle, Recognition, make_env
from fishrl.envs.control import ContinuousFrequency, DirectFrequencies
from fishrl.envs.episodes import count_decisions, run_episodes
from fishrl.envs.flow_env import FlowEnv
from fishrl.envs.sensors import wrap_angle
from fishrl.envs.steering import PolicySteering
from fishrl.files import load_tensors, staged
from fishrl.physics.cache_key import hash_sources, make_key
from fishrl.physics.fast.identity import identify_for_file
from fishrl.training.baselines import make_baseline
from fishrl.training.callback import SILENT, Callback
from fishrl.training.checkpoint import Checkpoint
from fishrl.training.plan import Plan
from fishrl.training.policies import load_policy

#: Duration of a trial in T, regardless of the length of training episodes.
PERIODS = 100.0
#: Initial position of the nose, regardless of the training; body lengths.
START_X_BL, START_Y_BL = (1.5, 2.0), (-0.1, 0.1)
#: Frames within an action, for phases.
FRAMES = 8
#: Entries of ``Histories``: work done since the start.
WORKS = ("work", "positive_work", "lateral_work", "torque_work")
_TRAINING = tuple(f"fishrl.training.{name}" for name in ("algorithms", "baselines", "policies"))
_SOURCES = ("fishrl.envs", "fishrl.modules", *_TRAINING, __name__)


class Histories(NamedTuple):
    """E episodes of at most N decisions, with M frames in each; NaN after an episode's end."""

    flow: Tensor  #: [E] index of the flow
    place: Tensor  #: [E, N + 1, 2] nose (x downstream, y) from the start on, body lengths
    frequency: Tensor  #: [E, N] beats per T of each interval
    named: Tensor  #: [E, N] flow label given to the policy at the decision; NaN without one
    angle_of_attack: Tensor  #: [E, N] at the end of the interval, radians
    work: Tensor  #: [E, N + 1] net work of the muscles since the start, rho L^2 (L / T)^2
    positive_work: Tensor  #: [E, N + 1] where no marker gives back what the flow does on it
    lateral_work: Tensor  #: [E, N + 1] in the paper's form
    torque_work: Tensor  #: [E, N + 1] of the external torque that holds the heading
    lengths_T: Tensor  #: [E] duration of the episode, also within its last interval
    terminated: Tensor  #: [E] bool, whether it left the safe area
    diverged: Tensor  #: [E] bool
    beat: Tensor  #: [E, N M] phase of the tail beat at the end of each frame, radians
    lift: Tensor  #: [E, N M] mean on the obstacle within each frame, rho (L / T)^2 L; 0 without one


def pick(histories: Histories, rows: Tensor) -> Histories:
    """Return some of the episodes; ``rows`` is a mask ``[E]``."""
    return Histories(*(value[rows] for value in histories))


def concatenate(parts: Sequence[Histories]) -> Histories:
    """Return the episodes of several recordings."""
    return Histories(*(torch.cat(values) for values in zip(*parts, strict=True)))


#: Settings of the task that policies must share to be compared.
SHARED = (
    *("body_length", "reynolds", "skin", "domain_bl", "stream", "safe_area"),
    *("control_interval_T", "time_limit"),
)


@dataclass(frozen=True, kw_only=True)
class Trial:
    """A policy to try in every flow; trials of one arm differ in their seed."""

    name: str  #: of the policy, for tables
    arm: str  #: kind of policy
    task: KarmanGait  #: with all flows and the duration of the trial, see ``prolong``
    make_policy: Callable[[], Any]
    identity: str  #: what determines its behaviour besides the task
    recognition: Recognition | None = None  #: gives it flow labels


def check_comparable(tried: Sequence[Trial]) -> None:
    """Raise ValueError for equal names, different tasks, and flows behind several half discs."""
    names = [trial.name for trial in tried]
    if not names or len(set(names)) < len(names):
        raise ValueError(f"policy names must be unique and non-empty; got {sorted(names)}")
    for setting in SHARED:
        values = {trial.name: getattr(trial.task, setting) for trial in tried}
        if len(set(map(repr, values.values()))) > 1:
            raise ValueError(f"tasks differ in {setting}: {values}; try them separately")
    if len(set(tried[0].task.stream.diameters_bl)) > 1:  # results are named by the speed alone
        raise ValueError(
            "flows behind several half discs: give one task.stream.diameter_bl (fishrl evaluate "
            "takes policies that were trained behind several)"
        )


def prolong(task: KarmanGait, periods: float) -> KarmanGait:
    """Return the task with all flows, steady, fixed starts, and ``periods`` in T."""
    return replace(
        task,
        stream=replace(task.stream, changes=None),
        start_flows=tuple(range(len(task.stream.speeds_bl))),
        time_limit=count_decisions(task, periods),
        start_x_bl=START_X_BL,
        start_y_bl=START_Y_BL,
    )


def load_trial(
    run: Path, *, periods: float = PERIODS, recognition: Recognition | None = None
) -> Trial:
    """Return the trial of the learned policy of a run folder, with its classifier or another."""
    found = Checkpoint.find(run)
    path, plan = found.path, Plan.from_config(found.config)
    source, task = recognition or plan.recognition, plan.task
    if source is not None:
        task = source.check(task)
    if not isinstance(task, KarmanGait):
        raise ValueError(f"{run}: a policy of {type(task).__name__}; give runs of task=karman_gait")
    arm, files = name_arm(task, source), sorted(path.rglob("*-actor/*"))
    return Trial(
        name=f"{arm} {run.name}".replace(" ", "-"),
        arm=arm,
        task=prolong(task, periods),
        recognition=source,
        make_policy=partial(load_policy, path, task=task, has_labels=source is not None),
        identity=make_key(*(file.read_bytes() for file in files), source and source.identity),
    )


def name_arm(task: KarmanGait, recognition: Recognition | None) -> str:
    """Name the kind of a learned policy."""
    if isinstance(task.control, ContinuousFrequency):
        return "continuous frequency"
    if isinstance(task.control, DirectFrequencies):
        return "lateral line alone" if recognition and task.num_label_inputs else "ablation"
    if recognition is None:
        return "macro-actions alone"
    return "oracle" if recognition == Oracle() else "both modules"


def make_trial(name: str, task: KarmanGait, *, periods: float = PERIODS) -> Trial:
    """Return the trial of a baseline, which is given the true flow label.

    Names are those of ``make_baseline``; ``passive`` and ``shedding`` (the shedding frequency of
    each flow), regardless of the task's rows; with ``+policy`` appended, the learned heading
    controller steers.
    """
    task = replace(task, reads_flow_class=False)
    kind = name.removesuffix("+policy")
    if kind != name:
        per_T = max(1, round(1.0 / task.interval_T))
        task = replace(task, steering=PolicySteering(decisions_per_T=per_T))
    if kind in ("passive", "shedding"):
        rates = list_shedding(task) if kind == "shedding" else [0.0]
        most = task.control.max_frequency
        if not all(rate <= most for rate in rates):
            raise ValueError(f"baseline {name}: beats at {rates} per T, possible are 0 to {most}")
        # the highest frequency stays in the row: it determines T, and so the flow
        row = tuple(sorted({0.0, *rates, most}))
        task = replace(task, control=DirectFrequencies(frequencies=row))
    make_policy = partial(make_baseline, kind, task=task, seed=0)
    make_policy()  # refuses an unknown name before anything is run
    task = prolong(task, periods)
    return Trial(name=name, arm=name, task=task, make_policy=make_policy, identity=name)


def list_shedding(task: KarmanGait) -> list[float]:
    """Return the shedding frequency of each flow, per T; NaN in free streams."""
    if task.wakes is None:
        return [math.nan] * len(task.stream.speeds_bl)
    frequencies: list[float] = (task.wakes.shedding_frequencies * task.scales.period).tolist()
    return frequencies


def run_trial(
    trial: Trial, *, episodes: int, folder: Path, flows: Flows, progress: Callback = SILENT
) -> list[Histories]:
    """Run ``episodes`` from fixed starts in each flow, or read them from the folder if it can."""
    task, num_streams = trial.task, len(trial.task.stream.speeds_bl)
    sources = hash_sources(*_SOURCES)
    versions = (identify_for_file(task), sources, torch.__version__)
    key = make_key(task, trial.identity, episodes, FRAMES, *versions)
    path = folder / "histories" / f"{trial.name}-{key}.pt"
    if path.is_file():
        kept = load_tensors(path, what="histories", remedy="delete the file")
        return [pick(Histories(**kept), kept["flow"] == flow) for flow in range(num_streams)]
    starts: TensorDict = task.sample_starts(
        num_streams * episodes, torch.Generator().manual_seed(0)
    )
    # the same noses, phases and keys in each flow for every policy
    starts = torch.cat([starts[:episodes]] * num_streams)
    starts["flow_index"] = torch.arange(num_streams).repeat_interleave(episodes)
    histories = record(trial, starts, flows=flows, progress=progress)
    path.parent.mkdir(parents=True, exist_ok=True)
    with staged(path) as stage:
        torch.save(histories._asdict(), stage)
    return [pick(histories, histories.flow == flow) for flow in range(num_streams)]


def record(
    trial: Trial, starts: TensorDictBase, *, flows: Flows, progress: Callback = SILENT
) -> Histories:
    """Run one episode from each start ``[E]``, all side by side."""
    task = trial.task
    env = make_env(
        task=task,
        flows=replace(flows, num_envs=len(starts)),
        seed=0,
        frames_per_action=FRAMES,
        recognition=trial.recognition,
    )
    base = env.base_env
    progress.on_phase(trial.name, total=task.time_limit)

    def read_place() -> dict[str, Tensor]:
        return {name: base.now[name] for name in ("place", *WORKS)}

    def read_frame(start_of: Tensor, flows: FlowEnv) -> dict[str, Tensor]:
        fish, *obstacles = flows.solver.bodies
        impulse = obstacles[0].impulse[:, 1] if obstacles else torch.zeros_like(fish.age)
        return {"beat": fish.phase, "age": fish.age, "impulse": impulse}

    def read_decision(start_of: Tensor, step: TensorDictBase) -> dict[str, Tensor]:
        progress.on_progress(1)
        unnamed = torch.full(step.shape, torch.nan)
        return {
            **read_place(),
            "frequency": base.now["frequency"],
            "angle_of_attack": wrap_angle(base.now["heading"] - torch.pi),
            "named": step.get("flow_class", unnamed).reshape(-1).double(),
            "lengths_T": base.now["age"].float() / task.scales.period,
        }

    episodes = run_episodes(
        env,
        trial.make_policy().to(flows.device),
        starts,
        on_begin=lambda start_of, state: read_place() | read_frame(start_of, base),
        on_step=read_decision,
        on_frame=read_frame,
    )
    env.close()
    num, traces = task.time_limit, episodes.traces
    lengths = dict.fromkeys(("place", *WORKS), num + 1)
    lengths |= dict.fromkeys(("beat", "age", "impulse"), num * FRAMES + 1)
    series = {name: traces.pad(name, length=lengths.get(name, num)) for name in traces}
    beat, age, impulse = (series.pop(name) for name in ("beat", "age", "impulse"))
    unit = task.body_length * (task.body_length / task.scales.period) ** 2
    series["lengths_T"] = torch.stack([ages[-1] for ages in traces["lengths_T"]])
    return Histories(
        flow=starts["flow_index"].cpu(),
        beat=beat[:, 1:],
        lift=impulse.diff(dim=1) / age.diff(dim=1).clamp_min(1.0) / unit,
        terminated=episodes.terminated,
        diverged=episodes.diverged,
        **series,
    )
