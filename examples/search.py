"""Search for learning settings with Optuna: ``python examples/search.py --trials 20``.

Each trial trains one run in ``<folder>/trial_<number>``. The same command continues a search that
was killed: the unfinished trial first, from its last checkpoint; a larger ``--trials`` extends it.
Needs ``pip install 'fishrl[sweep]'``. ``fishrl summarize <folder>`` compares the runs.
"""

import argparse
import logging
from pathlib import Path

import optuna
from optuna.distributions import BaseDistribution, FloatDistribution, IntDistribution
from optuna.trial import TrialState

from fishrl.envs import AbstractTask, Flows, Predation
from fishrl.training import LearningSettings, Progress, RunSettings, train

#: Distributions of arguments of ``LearningSettings``.
SPACE: dict[str, BaseDistribution] = {
    "learning_rate": FloatDistribution(1e-5, 1e-2, log=True),
    "gamma": FloatDistribution(0.9, 0.999),
    "batch_size": IntDistribution(16, 128, log=True),
}


def search(
    task: AbstractTask,
    folder: Path,
    *,
    trials: int,
    metric: str,
    flows: Flows = Flows(),
    **run: int,
) -> optuna.Study:
    """Maximise an entry of the summary; ``run`` are arguments of ``RunSettings``."""
    folder.mkdir(parents=True, exist_ok=True)
    study = optuna.create_study(
        storage=f"sqlite:///{folder / 'study.db'}",
        study_name="search",
        direction="maximize",
        load_if_exists=True,
    )
    unfinished = study.get_trials(states=[TrialState.RUNNING])
    numbers = [trial.number for trial in unfinished]
    while numbers or len(study.trials) < trials:
        study.sampler = optuna.samplers.TPESampler(seed=len(study.trials))
        number = numbers.pop() if numbers else study.ask(SPACE).number
        params = study.trials[number].params
        with Progress() as progress:
            summary = train(
                task=task,
                learning=LearningSettings(flows=flows, **params),
                run=RunSettings(folder=str(folder), name=f"trial_{number}", **run),
                callbacks=[progress],
            )
        study.tell(number, summary[metric])
    return study


def main() -> None:
    """Search on predation, and print the best settings."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, default=Path("runs/search"))
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--frames", type=int, default=1400)
    parser.add_argument("--metric", default="mean_return")
    given = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    study = search(
        Predation(),
        given.folder,
        trials=given.trials,
        metric=given.metric,
        total_frames=given.frames,
    )
    print(f"{given.metric} {study.best_value:g} with {study.best_params}")


if __name__ == "__main__":
    main()
