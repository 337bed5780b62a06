"""Record transitions of a policy as a Minari dataset: ``fishrl export-data ...``.

``checkpoint=runs/<name> name=fishrl/predation-expert-v0`` writes ``<folder>/<name>``, which
``minari.load_dataset`` and TorchRL's ``MinariExperienceReplay`` read. Observations hold
``observation`` (the stack that policies see) and ``action_mask``; infos hold all that the task
reports, such as the signals of the lateral line. Needs the extra ``export``.
"""

from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import PositiveInt

from fishrl.programs.policy_settings import PolicySettings, read_task
from fishrl.programs.program import program
from fishrl.training.callback import SILENT, Callback
from fishrl.training.evaluation import fixed_starts
from fishrl.training.progress import Progress

if TYPE_CHECKING:
    from minari import MinariDataset


class ExportDataSettings(PolicySettings):
    """Settings of a dataset.

    Args:
        name: identifier of the dataset, ``(<namespace>/)<name>-v<version>``.
        folder: folder of the datasets; Minari finds them by ``MINARI_DATASETS_PATH=<folder>``.
        episodes: fixed starts, one episode each.
    """

    name: str
    folder: str = "datasets"
    episodes: PositiveInt = 64


def record(settings: ExportDataSettings, *, progress: Callback = SILENT) -> "MinariDataset":
    """Run the episodes and write them."""
    from fishrl.wrappers.minari import find_dataset, write_dataset

    find_dataset(settings.name, settings.folder)
    task, recognition, policy = settings.make_policy()
    num_envs = min(settings.flows.num_envs, settings.episodes)
    env = settings.make_env(task, recognition, num_envs=num_envs, progress=progress)
    with closing(env):
        progress.on_phase("episodes", total=settings.episodes)
        return write_dataset(
            env,
            policy,
            fixed_starts(task, settings.episodes, seed=settings.seed),
            name=settings.name,
            folder=settings.folder,
            seed=settings.seed,
            algorithm=settings.learned or settings.policy,
            on_episodes=progress.on_progress,
        )


@program(ExportDataSettings, groups={"task": "predation", "preset": None}, stored=read_task)
def main(settings: ExportDataSettings) -> None:
    """Record, write and say what."""
    with Progress() as progress:
        data = record(settings, progress=progress)
    print(
        f"written to {Path(settings.folder) / settings.name}: {data.total_steps} transitions of "
        f"{data.total_episodes} episodes; read with MINARI_DATASETS_PATH={settings.folder}"
    )
