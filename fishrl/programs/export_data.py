"""Record transitions of a policy as a Minari dataset: ``fishrl export-data ...``.

``checkpoint=runs/<name> name=fishrl/predation-expert-v0`` writes ``<folder>/<name>``, which
``minari.load_dataset`` and TorchRL's ``MinariExperienceReplay`` read. Observations hold
``observation`` (the stack that policies see) and ``action_mask``; infos hold all that the task
reports, such as the signals of the lateral line. Needs the extra ``export``.
"""

from __future__ import annotations

import os
import warnings
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from omegaconf import MISSING
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs.utils import ExplorationType

from fishrl.bounds import bounded
from fishrl.envs import run_episodes
from fishrl.extras import show_install
from fishrl.programs.program import program
from fishrl.programs.train_settings import PolicySettings, read_task
from fishrl.training.evaluation import fixed_starts
from fishrl.training.progress import Progress

if TYPE_CHECKING:
    from minari import MinariDataset


@dataclass(frozen=True, kw_only=True)
class ExportDataSettings(PolicySettings):
    """Settings of a dataset.

    Args:
        name: identifier of the dataset, ``(<namespace>/)<name>-v<version>``.
        folder: folder of the datasets; Minari finds them by ``MINARI_DATASETS_PATH=<folder>``.
        episodes: fixed starts, one episode each.
        num_envs: flows that advance together.
        samples_actions: sample the actions of a stochastic policy (SAC, PPO), as in training.
    """

    name: str = MISSING
    folder: str = "datasets"
    episodes: int = bounded(64, least=1)
    num_envs: int = bounded(16, least=1)
    samples_actions: bool = False


def record(settings: ExportDataSettings, *, progress: Progress) -> MinariDataset:
    """Run the episodes and write them."""
    import minari
    from gymnasium.spaces import Box, Dict, Discrete, MultiBinary
    from minari.data_collector import EpisodeBuffer
    from minari.dataset.minari_dataset import parse_dataset_id

    parse_dataset_id(settings.name)
    path = Path(settings.folder).expanduser().absolute() / settings.name
    if path.exists():
        raise ValueError(f"{path} exists: take the next version in name={settings.name}")
    task, recognition, policy = settings.make_policy()
    if task.num_fish > 1:
        raise ValueError(
            f"task: {type(task).__name__} has several fish, and Minari's datasets hold one agent"
        )
    episodes: list[dict[str, list[Any]]] = [{} for _ in range(settings.episodes)]
    num_envs = min(settings.num_envs, settings.episodes)
    env = settings.make_env(task, recognition, num_envs=num_envs, progress=progress)
    is_continuous = task.action_bounds is not None
    masked = () if is_continuous else ("action_mask",)
    reported = [name for name in env.base_env.observation_spec if name not in masked]

    def keep(start_of: Tensor, **entries: TensorDictBase) -> None:
        for row, start in enumerate(start_of.tolist()):
            for part in entries.values() if start >= 0 else ():
                for name, value in part[row].items():
                    episodes[start].setdefault(name, []).append(value.cpu().numpy())

    def begin(start_of: Tensor, state: TensorDictBase) -> None:
        keep(start_of, state=state.select("observation_stack", *masked, *reported))

    def settle(start_of: Tensor, step: TensorDictBase) -> None:
        after = step["next"]
        outcome = after.select("reward", "terminated", "truncated")
        keep(start_of, action=step.select("action"), outcome=outcome)
        begin(start_of, after)
        progress.advance(int((after["done"].squeeze(-1) & (start_of >= 0)).sum()))

    kind = ExplorationType.RANDOM if settings.samples_actions else ExplorationType.DETERMINISTIC
    torch.manual_seed(settings.seed)  # of sampled actions
    with closing(env):
        progress.start("episodes", total=settings.episodes)
        run_episodes(
            env,
            policy,
            fixed_starts(task, settings.episodes, seed=settings.seed),
            exploration=kind,
            on_begin=begin,
            on_step=settle,
        )
        size = env.observation_spec["observation_stack"].shape[-1]
    seen, num = Box(-np.inf, np.inf, (size,), np.float32), task.num_actions
    buffers = []
    for index, entries in enumerate(episodes):
        series = {name: np.stack(values) for name, values in entries.items()}
        masks = {name: series[name].astype(np.int8) for name in masked}
        buffers.append(
            EpisodeBuffer(
                id=index,
                seed=settings.seed,
                observations={"observation": series["observation_stack"], **masks},
                actions=series["action"],
                rewards=series["reward"][:, 0],
                terminations=series["terminated"][:, 0],
                truncations=series["truncated"][:, 0],
                infos={name: series[name] for name in reported},
            )
        )
    os.environ["MINARI_DATASETS_PATH"] = str(Path(settings.folder).expanduser().absolute())
    warnings.simplefilter("ignore", UserWarning)  # about fields for its public server
    return minari.create_dataset_from_buffers(
        settings.name,
        buffers,
        observation_space=Dict({"observation": seen, **dict.fromkeys(masked, MultiBinary(num))}),
        action_space=Box(-1.0, 1.0, (num,), np.float32) if is_continuous else Discrete(num),
        algorithm_name=settings.learned or settings.policy,
        description=f"{settings.episodes} episodes of {task}",
        requirements=["fishrl"],
    )


@program(ExportDataSettings, groups={"task": "predation", "preset": None}, stored=read_task)
def main(settings: ExportDataSettings) -> None:
    """Record, write and say what."""
    try:
        import minari  # noqa: F401
    except ImportError as error:
        raise ImportError(f"datasets need packages: {show_install('export')}") from error
    with Progress() as progress:
        data = record(settings, progress=progress)
    print(
        f"written to {Path(settings.folder) / settings.name}: {data.total_steps} transitions of "
        f"{data.total_episodes} episodes; read with MINARI_DATASETS_PATH={settings.folder}"
    )
