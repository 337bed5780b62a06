"""Episodes of a policy as a Minari dataset; needs the extra ``export``.

``minari.load_dataset`` reads the dataset. ``MinariExperienceReplay`` of TorchRL 0.14.1 reads its
spaces, but zeros instead of the data of any Minari dataset.
"""

import os
import re
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import TransformedEnv

from fishrl.envs.episodes import Policy, run_episodes
from fishrl.extras import needing
from fishrl.files import claim
from fishrl.settings import checked

with needing("export", __name__):
    import minari
    from gymnasium.spaces import Box, Dict
    from minari.data_collector import EpisodeBuffer
    from minari.dataset.minari_dataset import parse_dataset_id

    from fishrl.wrappers.spaces import make_spaces


def find_dataset(name: str, folder: str | Path) -> Path:
    """Return the path of a new dataset; raise ValueError if its name is invalid or exists."""
    if not re.search(r"-v\d+$", name):
        raise ValueError(f"name = {name}: give a version, as in fishrl/predation-expert-v0")
    parse_dataset_id(name)
    path = Path(folder).expanduser().absolute() / name
    if path.exists():
        raise ValueError(f"{path} exists: increase the version in name={name}")
    return path


@checked
def write_dataset(
    env: TransformedEnv,
    policy: Policy,
    starts: TensorDictBase,
    *,
    name: str,
    folder: str | Path,
    seed: int = 0,
    algorithm: str | None = None,
    on_episodes: Callable[[int], None] | None = None,
) -> minari.MinariDataset:
    """Run one episode from each start and write their transitions to ``<folder>/<name>``.

    Observations hold the stacked ``observation`` and, for discrete actions, ``action_mask``; infos
    hold all entries that the task reports, such as the lateral-line signals; ``reward/<term>`` is
    ``reward_<term>``.

    Args:
        env: an environment of ``make_env``.
        policy: writes ``action``.
        starts: initial conditions ``[E]`` of ``task.sample_starts``.
        name: identifier of the dataset, ``(<namespace>/)<name>-v<version>``.
        folder: folder of the datasets; ``minari.load_dataset`` finds them where the environment
            variable ``MINARI_DATASETS_PATH`` names it.
        seed: seed of the starts, stored with the dataset.
        algorithm: name of the policy, stored with the dataset.
        on_episodes: called with the number of episodes that have just ended.

    Raises:
        ValueError: for several fish, and as ``find_dataset``.
    """
    path = find_dataset(name, folder)
    task = env.base_env.task
    if task.num_fish > 1:
        raise ValueError(
            f"task: {type(task).__name__} has several fish, but a Minari dataset has one agent"
        )
    with claim(path):
        find_dataset(name, folder)  # another process may have just written it
        masked = () if task.action_bounds is not None else ("action_mask",)
        reported = [key for key in env.base_env.observation_spec if key not in masked]

        def read(start_of: Tensor, state: TensorDictBase) -> dict[str, Tensor]:
            return dict(state.select("observation_stack", *masked, *reported).items())

        def read_step(start_of: Tensor, step: TensorDictBase) -> dict[str, Tensor]:
            outcome = step["next"].select("reward", "terminated", "truncated")
            return {"action": step["action"], **outcome, **read(start_of, step["next"])}

        episodes = run_episodes(
            env, policy, starts, on_begin=read, on_step=read_step, on_episodes=on_episodes
        )
        traces = dict(episodes.traces)
        buffers = []
        for index in range(len(starts)):
            arrays = {key: values[index].numpy() for key, values in traces.items()}
            masks = {key: arrays[key].astype(np.uint8) for key in masked}
            buffer = EpisodeBuffer(
                id=index,
                seed=seed,
                observations={"observation": arrays["observation_stack"], **masks},
                actions=arrays["action"],
                rewards=arrays["reward"][:, 0],
                terminations=arrays["terminated"][:, 0],
                truncations=arrays["truncated"][:, 0],
                infos={key.replace("/", "_"): arrays[key] for key in reported},
            )
            buffers.append(buffer)
        seen, actions = make_spaces(env)
        mask = Box(0, 1, (task.num_actions,), np.uint8)  # TorchRL cannot read MultiBinary
        root = Path(folder).expanduser().absolute()
        with TemporaryDirectory(prefix=".", dir=root) as stage, warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # missing metadata for the public server
            with _naming(stage):
                minari.create_dataset_from_buffers(
                    name,
                    buffers,
                    observation_space=Dict({"observation": seen, **dict.fromkeys(masked, mask)}),
                    action_space=actions,
                    algorithm_name=algorithm,
                    description=f"{len(starts)} episodes of {task}",
                    requirements=["fishrl"],
                )
            Path(stage, name).rename(path)
            for rest in Path(stage).rglob("*.json"):  # of a namespace
                if not (target := root / rest.relative_to(stage)).exists():
                    rest.rename(target)
        with _naming(root):
            return minari.load_dataset(name)


@contextmanager
def _naming(folder: str | Path) -> Iterator[None]:
    """Name the folder of the datasets to Minari, which takes it from the environment alone."""
    name = "MINARI_DATASETS_PATH"
    before = os.environ.get(name)
    os.environ[name] = str(folder)
    try:
        yield
    finally:
        del os.environ[name]
        if before is not None:
            os.environ[name] = before
