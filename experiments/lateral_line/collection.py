"""Labelled signals from real flows: collected once, in pieces that survive an interruption.

Fish take half of their decisions at random, and half so as to hold a station, drawn for each
episode: they come where a learner comes, and stay where a learned fish stays. The flow that picks
their row of frequencies is drawn at random too, apart from the flow that they are in: otherwise
their own tail beat would give the flow away, and a machine that once erred would hear its error
confirmed.
"""

from __future__ import annotations

import hashlib
import inspect
import logging
import pickle
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase

import fishrl.envs
from fishrl.envs import FlowEnv
from fishrl.envs.lateral_line import KNOWN
from fishrl.physics.cache_key import hash_sources
from fishrl.training.baselines import make_pid
from fishrl.training.evaluation import copy_state
from fishrl.training.progress import Progress

logger = logging.getLogger(__name__)

#: Of the decisions, taken at random.
RANDOM_SHARE = 0.5


@dataclass(frozen=True, kw_only=True)
class Collection:
    """What shapes the data.

    Args:
        task: with a lateral line and flows to tell apart; what it really senses does not matter, as
            every feature of every neuromast is recorded.
        num_envs: flows that advance together; one episode each makes a piece.
        max_decisions: after which an episode is cut.
        seed: of starts, named flows, stations and actions.
    """

    task: Any
    num_envs: int = 16
    max_decisions: int = 60
    seed: int = 0

    def __post_init__(self) -> None:
        """Record everything, and refuse a task without a lateral line."""
        task = self.task
        if not hasattr(task, "flow_labels") or len(task.flow_labels) < 2:
            raise ValueError(
                f"{type(task).__name__} has no two flows to tell apart by a lateral line: take "
                "task=karman_gait with two or more stream.speeds_bl"
            )
        line = replace(
            task.lateral_line, features=KNOWN, is_averaged=False, noise=0.0, silence=0.0, delay=0
        )
        object.__setattr__(self, "task", replace(task, lateral_line=line, reads_flow_class=True))

    @property
    def key(self) -> str:
        """A word that changes when the data may: these settings, the flow or the environment."""
        folder = Path(inspect.getfile(fishrl.envs)).parent
        files = [*sorted(folder.rglob("*.py")), Path(__file__)]
        sources = [path.read_bytes() for path in files]
        digest = hashlib.sha256(b"\0".join(sources))
        digest.update("\0".join((repr(self), hash_sources(), torch.__version__)).encode())
        return digest.hexdigest()[:16]


def collect(
    collection: Collection,
    *,
    num_samples: int,
    folder: Path,
    device: str = "cpu",
    compile: bool = True,
    progress: Progress | None = None,
) -> TensorDict:
    """Collect episodes until they hold so many decisions; what lies in ``folder`` is not run again.

    Args:
        collection: what to collect.
        num_samples: decisions of one fish, one signal each.
        folder: below which the pieces are kept, in a folder of their own for each collection.
        device: cpu or cuda.
        compile: compile the flow solver.
        progress: the bar.

    Returns:
        TensorDict ``[E, D]`` of E episodes and at most D decisions: ``lateral_line``
        ``[E, D, W, P, F]`` with F features as in ``KNOWN``, what was felt in the interval before
        each decision; ``is_decision`` bool, false after the end; ``flow_index``, ``named_flow``
        (the row of frequencies in use) and ``episode`` int64; ``start`` ``[E, D, 2]``, where the
        nose was at the start, in L; ``frequency`` in beats per T.

    Raises:
        ValueError: if a piece cannot be read.
    """
    progress = progress or Progress(is_shown=False)
    place = folder.expanduser() / collection.key
    place.mkdir(parents=True, exist_ok=True)
    pieces: list[TensorDict] = []
    num_done, recorder = 0, None
    progress.start("collection", total=num_samples)
    while num_done < num_samples:
        path = place / f"piece-{len(pieces):04d}.pt"
        if path.is_file():
            piece = _read(path)
        else:
            recorder = recorder or _Recorder(collection, device=device, compile=compile)
            piece = recorder.record(len(pieces))
            stage = path.with_suffix(".stage")
            torch.save(piece.to_dict(), stage)
            stage.replace(path)
        pieces.append(piece)
        num_new = int(piece["is_decision"].sum())
        if num_new == 0:
            raise ValueError(f"{path}: no fish came to a decision; the starts are too dangerous")
        progress.advance(min(num_new, num_samples - num_done), episodes=sum(map(len, pieces)))
        num_done += num_new
    if recorder is not None:
        recorder.env.close()
    data: TensorDict = torch.cat(pieces)
    episode = torch.arange(data.shape[0])[:, None].expand(data.shape)
    return data.set("episode", episode.contiguous())


def _make_seed(seed: int, number: int) -> int:
    """Return the seed of a piece: other starts than those that fish are trained and judged from.

    torch's generator on a CPU reads 32 bits, so the numbers are mixed, not put side by side.
    """
    word = hashlib.sha256(f"lateral line {seed} {number}".encode()).digest()
    return int.from_bytes(word[:4], "big")


class _Recorder:
    """Runs one piece after another in the same flows."""

    def __init__(self, collection: Collection, *, device: str, compile: bool) -> None:
        self.collection = collection
        self.env = FlowEnv(
            task=collection.task,
            num_envs=collection.num_envs,
            device=device,
            compile_flow=compile,
        )
        self._initial = copy_state(self.env.state_dict())

    @torch.no_grad()
    def record(self, number: int) -> TensorDict:
        """Return the episodes ``[B, D]`` of piece ``number``; the same whatever ran before."""
        collection, env = self.collection, self.env
        generator = torch.Generator().manual_seed(_make_seed(collection.seed, number))
        num, num_flows = collection.num_envs, len(collection.task.flow_labels)
        starts = collection.task.sample_starts(num, generator)
        flow = (torch.arange(num) + num * number) % num_flows  # as many episodes of each
        named = torch.randint(num_flows, (num,), generator=generator)
        starts["flow_index"] = flow
        env.load_state_dict(copy_state(self._initial))
        env.starts = starts.to(env.device)
        is_over = torch.zeros(num, dtype=torch.bool)
        env.is_resting = is_over.to(env.device)
        td = env.reset()
        start = (starts["head"] / collection.task.body_length).float()
        area = collection.task.safe_area
        low, high = area.near_bl + area.rim_bl, area.far_bl - area.rim_bl
        station = low + (high - low) * torch.rand(num, generator=generator)
        holder = make_pid(collection.task, station_bl=station.to(env.device))
        told = {"flow_index": flow, "named_flow": named, "start": start}
        decisions: list[TensorDict] = []
        for decision in range(collection.max_decisions):
            decisions.append(_describe(td, is_decision=~is_over, **told))
            td.set("flow_class", named.to(env.device))
            td.set("is_init", torch.full((num, 1), decision == 0, device=env.device))
            drawn = torch.multinomial(td["action_mask"].float().cpu(), 1, generator=generator)
            wanted = holder(td)["action"].cpu()
            is_random = torch.rand(num, generator=generator) < RANDOM_SHARE
            td.set("action", torch.where(is_random, drawn.squeeze(-1), wanted).to(env.device))
            td = env.step(td)["next"]
            is_over = is_over | td["done"].squeeze(-1).cpu()
            env.is_resting = is_over.to(env.device)
        return torch.stack(decisions, 1)


def _describe(td: TensorDictBase, **told: torch.Tensor) -> TensorDict:
    return TensorDict(
        {
            "lateral_line": td["lateral_line"].cpu(),
            "frequency": td["frequency"].squeeze(-1).float().cpu(),
            **told,
        },
        td.batch_size,
    )


def _read(path: Path) -> TensorDict:
    try:
        content = torch.load(path, weights_only=True)
        return TensorDict(content, content["is_decision"].shape)
    except (OSError, RuntimeError, EOFError, KeyError, pickle.UnpicklingError) as error:
        raise ValueError(
            f"data {path}: cannot be read ({type(error).__name__}); delete the file"
        ) from error
