"""Record transitions of a policy as a Minari dataset: ``fishrl export-data ...``.

``policy=runs/<name> name=fishrl/predation-expert-v0`` writes ``<folder>/<name>``. Read it with
``minari.load_dataset``: TorchRL's ``MinariExperienceReplay`` returns zeros. Observations hold
``observation`` (the stack that policies see) and ``action_mask``; infos hold all that the task
reports, such as the signals of the lateral line. Needs the extra ``export``.
"""

from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

from pydantic import PositiveInt

from fishrl.programs.program import program
from fishrl.programs.stored_task import POLICY
from fishrl.training.evaluation import fixed_starts
from fishrl.training.policies import evaluate, prepare
from fishrl.training.progress import Progress


@program(evaluate, **POLICY)
def main(
    *,
    name: str,
    folder: str = "datasets",
    episodes: PositiveInt = 64,
    preset: str | None = None,
    **given: Any,
) -> None:
    """Record episodes and write them as a dataset.

    Args:
        name: identifier of the dataset, ``(<namespace>/)<name>-v<version>``.
        folder: folder of the datasets; Minari finds them by ``MINARI_DATASETS_PATH=<folder>``.
        episodes: fixed starts, one episode each.
        preset: name of a preset; only its task is used.
        **given: arguments of ``evaluate``.
    """
    from fishrl.wrappers.minari import find_dataset, write_dataset

    find_dataset(name, folder)
    given["flows"] = replace(given["flows"], num_envs=min(given["flows"].num_envs, episodes))
    with Progress() as progress:
        env, policy = prepare(**given, callback=progress)
        with closing(env):
            progress.on_phase("episodes", total=episodes)
            data = write_dataset(
                env,
                policy,
                fixed_starts(env.base_env.task, episodes, seed=given["seed"]),
                name=name,
                folder=folder,
                seed=given["seed"],
                algorithm=str(given["policy"]),
                on_episodes=progress.on_progress,
            )
    print(
        f"written to {Path(folder) / name}: {data.total_steps} transitions of "
        f"{data.total_episodes} episodes; read with MINARI_DATASETS_PATH={folder}"
    )
