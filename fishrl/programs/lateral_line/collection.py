"""Labelled signals from real flows: collected once, in pieces that survive an interruption.

Half of the actions are random and half hold a station drawn for each episode, so that the fish
visits the states of an untrained policy and of a trained one. The row of frequencies is drawn
independently of the flow: otherwise the tail beat would reveal the flow, and in use a wrong
prediction would confirm itself.
"""

import hashlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from pydantic import NonNegativeInt, PositiveInt
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import TransformedEnv

from fishrl.envs import AbstractTask, Flows, make_env
from fishrl.envs.episodes import run_episodes
from fishrl.envs.extensions import HasFlowLabels
from fishrl.envs.lateral_line import KNOWN
from fishrl.files import load_tensors, staged
from fishrl.physics.cache_key import hash_sources, make_key
from fishrl.physics.fast.identity import identify_for_file
from fishrl.settings import Settings
from fishrl.training.baselines import make_pid
from fishrl.training.callback import SILENT, Callback
from fishrl.training.run_folder import naming_folder

#: Share of random actions.
RANDOM_SHARE = 0.5
_SOURCES = ("fishrl.envs", "fishrl.modules", "fishrl.training.baselines", __name__)


class CollectionSettings(Settings):
    """Settings of a collection.

    Args:
        task: task all of whose flows are classified, regardless of ``task.start_flows``.
        preset: name of a preset; only its task is used.
        seed: seed of data, splits and fits.
        flows: number of flows, and how they are computed.
        data_folder: cache of collected data, shared by all studies that can use them.
        num_samples: decisions to collect, one signal of a control interval each.
        max_decisions: decisions after which an episode is truncated.
    """

    task: AbstractTask
    preset: str | None = None
    seed: NonNegativeInt = 0
    flows: Flows = Flows()
    data_folder: str = "runs/lateral_line_data"
    num_samples: PositiveInt = 6000
    max_decisions: PositiveInt = 60

    @property
    def recorded_task(self) -> Any:
        """Task that records every feature of every neuromast."""
        task: Any = self.task
        has_labels = isinstance(task, HasFlowLabels) and len(task.flow_labels) > 1
        if not (has_labels and task.lateral_line_layout):
            raise ValueError(
                f"{type(task).__name__} has no two flows to tell apart by a lateral line: take "
                "task=karman_gait with two or more stream.speeds_bl"
            )
        if task.lateral_line.num_neuromasts < 2:
            raise ValueError("task.lateral_line.num_neuromasts = 1: a classifier needs two or more")
        if task.action_bounds is not None:
            raise ValueError("signals are recorded at discrete actions: take task=karman_gait")
        whole = {"features": KNOWN, "is_averaged": False, "noise": 0.0, "silence": 0.0, "delay": 0}
        line = replace(task.lateral_line, **whole)
        limit = self.max_decisions
        return replace(task, lateral_line=line, reads_flow_class=True, time_limit=limit)

    @property
    def place(self) -> Path:
        """Folder of the data, named by a hash of everything that determines them."""
        task = self.recorded_task
        settings = (self.flows.num_envs, self.max_decisions, self.seed, identify_for_file(task))
        key = make_key(task, *settings, hash_sources(*_SOURCES), torch.__version__)
        return Path(self.data_folder).expanduser() / key


def collect(settings: CollectionSettings, progress: Callback = SILENT) -> TensorDict:
    """Collect episodes until they hold ``num_samples`` decisions, or read stored ones.

    Returns:
        TensorDict ``[E, D]`` of E episodes and at most D decisions: ``lateral_line``
        ``[E, D, W, P, F]`` with F features as in ``KNOWN``, sensed in the interval before each
        decision; ``is_decision`` bool, false after the end; ``flow_index`` (of a changing stream,
        the flow nearest to it at the decision) and ``episode`` int64.
    """
    s, task, place = settings, settings.recorded_task, settings.place
    with naming_folder(place, setting="data_folder"):
        place.mkdir(parents=True, exist_ok=True)
    pieces: list[TensorDict] = []
    num_done, env = 0, None
    progress.on_phase("collection", total=s.num_samples)
    while num_done < s.num_samples:
        path = place / f"piece-{len(pieces):04d}.pt"
        if not path.is_file():
            env = env or make_env(task=task, flows=s.flows, seed=0)
            with staged(path) as stage:
                torch.save(record_piece(env, len(pieces), seed=s.seed).to_dict(), stage)
        content = load_tensors(path, what="data", remedy="delete the file")
        pieces.append(TensorDict(content, content["is_decision"].shape))
        num_new = int(pieces[-1]["is_decision"].sum())
        shown = {"episodes": sum(map(len, pieces))}
        progress.on_progress(min(num_new, s.num_samples - num_done), shown)
        num_done += num_new
    if env is not None:
        env.close()
    data: TensorDict = torch.cat(pieces)
    episode = torch.arange(data.shape[0])[:, None].expand(data.shape)
    return data.set("episode", episode.contiguous())


def record_piece(env: TransformedEnv, number: int, *, seed: int) -> TensorDict:
    """Return the episodes ``[B, D]`` of a piece, which depend on env, seed and number only."""
    task, num = env.base_env.task, env.batch_size[0]
    num_flows = len(task.flow_labels)
    # a CPU generator has a seed of 32 bits; these differ from those of training and evaluation
    word = hashlib.sha256(f"lateral line {seed} {number}".encode()).digest()
    generator = torch.Generator().manual_seed(int.from_bytes(word[:4], "big"))
    starts = task.sample_starts(num, generator)
    flow = (torch.arange(num) + num * number) % num_flows  # as many episodes of each
    row = torch.randint(num_flows, (num,), generator=generator)
    starts["flow_index"] = flow
    duration_T = task.time_limit * task.interval_T
    starts.update(task.stream.draw_changes(flow, starts["episode_key"], duration_T=duration_T))
    area = task.safe_area
    low, high = area.near_bl + area.rim_bl, area.far_bl - area.rim_bl
    station = low + (high - low) * torch.rand(num, generator=generator)
    holder = make_pid(task, station_bl=station.to(env.device))

    def act(state: TensorDictBase) -> TensorDictBase:
        state["flow_class"] = row.to(env.device)
        random = torch.multinomial(state["action_mask"].float().cpu(), 1, generator=generator)
        held = holder(state)["action"].cpu()
        is_random = torch.rand(num, generator=generator) < RANDOM_SHARE
        return state.set("action", torch.where(is_random, random.squeeze(-1), held).to(env.device))

    def read(start_of: Tensor, step: TensorDictBase) -> dict[str, Tensor]:
        return {
            "lateral_line": step["lateral_line"],
            "is_decision": torch.ones_like(start_of, dtype=torch.bool),
            "flow_index": step["flow_index"].squeeze(-1),
        }

    traces = run_episodes(env, act, starts, on_step=read).traces
    read_off = {name: traces.pad(name, value=0, length=task.time_limit) for name in traces}
    return TensorDict(read_off, read_off["is_decision"].shape)
