"""Search for good settings: ``python -m experiments.search runs/search 'gamma=interval(0.9,1)'``.

Optuna proposes values, each trial trains, as one of a sweep's jobs does, and the study lies in
``study.db`` in the folder. The same command goes on with it, an interrupted or killed trial first;
given several times at once, it searches with several processes.
"""

from __future__ import annotations

import argparse
import json
import logging
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from experiments.command_line import plain_errors, set_up_logging, show_command
from experiments.search_path import FOLDER
from experiments.settings import ConfigError
from experiments.sweeps.ending import ending_runs
from experiments.sweeps.runs import Run, read_run
from fishrl.training.run_folder import HeldError, RunFolder

logger = logging.getLogger(__name__)

_LOOK_SECONDS = 0.5


@dataclass(frozen=True, kw_only=True)
class Search:
    """What a study searches, and by what measure.

    Args:
        folder: of the study and its runs.
        overrides: ``key=value`` for every trial, and ``key=interval(low,high)``,
            ``key=tag(log,interval(low,high))``, ``key=int(interval(low,high))`` or
            ``key=choice(a,b)`` for what is searched.
        metric: entry of summary.json.
        seeds: runs per trial, over which the metric is averaged.
        is_minimized: the smaller, the better.

    Raises:
        ConfigError: for unknown settings, and if nothing is searched.
    """

    folder: Path
    overrides: tuple[str, ...]
    metric: str = "mean_return"
    seeds: int = 1
    is_minimized: bool = False

    def __post_init__(self) -> None:
        """Refuse what cannot be searched."""
        if self.seeds < 1:
            raise ConfigError(f"seeds = {self.seeds}: must be at least 1")
        for override in self.parsed():
            key = override.key_or_group
            if key in ("seed", "name", "folder", "resume"):
                raise ConfigError(f"{key}=...: the search sets it itself; leave it away")
        if not self.space():
            raise ConfigError(
                "nothing to search: give one or more settings as key=interval(low,high), "
                "key=tag(log,interval(low,high)), key=int(interval(low,high)) or key=choice(a,b)"
            )

    def parsed(self) -> list[Any]:
        """Return the overrides, checked and parsed by hydra."""
        from hydra.core.override_parser.overrides_parser import OverridesParser

        from experiments.config import check_overrides

        checked = check_overrides("train", list(self.overrides), is_search=True)
        return list(OverridesParser.create().parse_overrides(checked))

    def space(self) -> dict[str, Any]:
        """Return what is searched: of each key, Optuna's distribution."""
        from hydra.core.override_parser.types import IntervalSweep
        from optuna.distributions import (
            BaseDistribution,
            CategoricalDistribution,
            FloatDistribution,
            IntDistribution,
        )

        space: dict[str, BaseDistribution] = {}
        for override in self.parsed():
            if not override.is_sweep_override():
                continue
            key, value = override.get_key_element(), override.value()
            if isinstance(value, IntervalSweep):
                low: Any = value.start
                high: Any = value.end
                is_log = "log" in value.tags
                try:
                    if isinstance(low, int) and isinstance(high, int):
                        space[key] = IntDistribution(low, high, log=is_log)
                    else:
                        space[key] = FloatDistribution(float(low), float(high), log=is_log)
                except ValueError as error:
                    raise ConfigError(f"{override.input_line}: {error}") from error
            else:
                space[key] = CategoricalDistribution(list(override.sweep_string_iterator()))
        return space

    def fixed(self) -> list[str]:
        """Return the overrides that every trial shares."""
        return [
            str(override.input_line)
            for override in self.parsed()
            if not override.is_sweep_override()
        ]

    def identity(self) -> str:
        """Say what makes the trials of a study comparable."""
        space = {key: str(distribution) for key, distribution in self.space().items()}
        told = [self.fixed(), space, self.metric, self.seeds, self.is_minimized]
        return json.dumps(told)


def search(plan: Search, *, trials: int) -> Any:
    """Run trials until the study has as many, those that were cut off first.

    Args:
        plan: the search.
        trials: of the whole study, failed ones and those of other processes too.

    Returns:
        Optuna's study.

    Raises:
        ConfigError: if there is another search in the folder.
    """
    import optuna

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    plan.folder.mkdir(parents=True, exist_ok=True)
    study = optuna.create_study(
        storage=f"sqlite:///{plan.folder.resolve() / 'study.db'}",
        study_name="search",
        direction="minimize" if plan.is_minimized else "maximize",
        load_if_exists=True,
    )
    if study.user_attrs.setdefault("identity", plan.identity()) != plan.identity():
        raise ConfigError(
            f"{plan.folder}: holds another search: {study.user_attrs['identity']}; take another "
            "folder, or give the same settings again"
        )
    study.set_user_attr("identity", plan.identity())
    for trial in study.get_trials(states=[optuna.trial.TrialState.RUNNING]):
        _run_trial(plan, study, trial.number)
    while len(study.trials) < trials:
        new = study.ask()
        # Its own seed: a search that goes on, or has several processes, draws nothing twice.
        study.sampler = optuna.samplers.TPESampler(seed=new.number)
        try:
            for name, distribution in plan.space().items():
                _suggest(new, name, distribution)
        except optuna.exceptions.UpdateFinishedTrialError:
            logger.info("trial %d: another search began meanwhile and gave it up", new.number)
            continue
        _run_trial(plan, study, new.number)
    return study


def _suggest(trial: Any, name: str, distribution: Any) -> None:
    from optuna.distributions import CategoricalDistribution, IntDistribution

    if isinstance(distribution, CategoricalDistribution):
        trial.suggest_categorical(name, distribution.choices)
        return
    is_whole = isinstance(distribution, IntDistribution)
    suggest = trial.suggest_int if is_whole else trial.suggest_float
    suggest(name, distribution.low, distribution.high, log=distribution.log)


def _run_trial(plan: Search, study: Any, number: int) -> None:
    """Train as a trial says and tell the study, unless another process is at it or has done it."""
    from optuna.trial import TrialState

    place = RunFolder(plan.folder / ".trials" / f"{number:04d}")
    place.path.mkdir(parents=True, exist_ok=True)
    try:
        lock = place.hold()
    except HeldError:
        return
    with lock:
        trial = study.trials[number]  # read anew: another process may just have finished it
        if trial.state != TrialState.RUNNING:
            return
        if set(trial.params) != set(plan.space()):  # killed before it was begun
            study.tell(number, state=TrialState.FAIL)
            return
        chosen = [f"{key}={value}" for key, value in trial.params.items()]
        logger.info("trial %d: %s", number, " ".join(chosen))
        values = [_run_seed(plan, number, chosen, seed) for seed in range(plan.seeds)]
        known = [value for value in values if value is not None]
        if len(known) < len(values):
            study.tell(number, state=TrialState.FAIL)
            return
        value = sum(known) / len(known)
        study.tell(number, value)
        logger.info("trial %d: %s = %g", number, plan.metric, value)


def _run_seed(plan: Search, number: int, chosen: Sequence[str], seed: int) -> float | None:
    """Run one seed of a trial, or read its result; None if it failed."""
    from experiments.config import load_config
    from experiments.sweeps.jobs import find_or_begin, quote, run_alone

    place = [f"seed={seed}", f"folder={quote(str(plan.folder))}"]
    name = f"trial_{number:04d}-seed_{seed}"
    try:
        config = load_config("train", [*plan.fixed(), *chosen, *place])
        run = _wait_for_others(find_or_begin(config, name=name).path)
    except ValueError as error:
        logger.info("%s: failed: %s", name, error)
        return None
    if run.status != "finished":
        run = run_alone(run.path, total_frames=config.total_frames)
    if run.status != "finished":
        logger.info("%s: %s: %s", name, run.status, run.reason)
        return None
    if plan.metric not in run.summary:
        numbers = sorted(k for k, v in run.summary.items() if isinstance(v, int | float))
        raise ConfigError(f"metric = {plan.metric}: not in {run.path}; there is {numbers}")
    value = run.summary[plan.metric]
    return None if value is None else float(value)


def _wait_for_others(path: Path) -> Run:
    """Read a run once no other process writes it, such as one that outlived its search."""
    run = read_run(path)
    if run.status == "running":
        logger.info("%s: another process writes it, which is waited for", path)
    while run.status == "running":
        time.sleep(_LOOK_SECONDS)
        run = read_run(path)
    return run


def report(plan: Search, study: Any) -> None:
    """Print the best trials and what to do with them."""
    done = [trial for trial in study.trials if trial.value is not None]
    print(f"\n{len(done)} of {len(study.trials)} trials finished in {plan.folder}")
    for trial in sorted(done, key=lambda t: t.value, reverse=not plan.is_minimized)[:5]:
        chosen = " ".join(f"{key}={value}" for key, value in trial.params.items())
        print(f"  trial {trial.number:<4} {plan.metric} {trial.value:<12.6g} {chosen}")
    print(f"table and curves: {show_command('experiments.summarize', str(plan.folder))}")


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description="Search for good settings with Optuna.")
    parser.add_argument("folder", type=Path, help="of the study; one that exists goes on")
    parser.add_argument("overrides", nargs="+", help="key=value, or key=interval(low,high), ...")
    parser.add_argument(
        *FOLDER, action="append", default=[], metavar="FOLDER", help="with tasks of one's own"
    )
    parser.add_argument("--trials", type=int, default=20, help="of the whole study")
    parser.add_argument("--seeds", type=int, default=1, help="runs per trial")
    parser.add_argument("--metric", default="mean_return", help="entry of summary.json")
    parser.add_argument("--minimize", action="store_true", help="the smaller, the better")
    arguments = parser.parse_intermixed_args()
    set_up_logging()
    with plain_errors():
        try:
            import optuna  # noqa: F401 - here, so that its absence is said at once
        except ImportError as error:
            raise ImportError(
                "the search needs the package optuna: pip install -e '.[sweep]'"
            ) from error
        if arguments.trials < 1:
            raise ConfigError(f"trials = {arguments.trials}: must be at least 1")
        folders = [f"--config-dir={folder}" for folder in arguments.config_dir]
        plan = Search(
            folder=arguments.folder,
            overrides=(*folders, *arguments.overrides),
            metric=arguments.metric,
            seeds=arguments.seeds,
            is_minimized=arguments.minimize,
        )
        try:
            with ending_runs(plan.folder):
                study = search(plan, trials=arguments.trials)
            report(plan, study)
        except KeyboardInterrupt:
            sys.exit("interrupted; the same command goes on")


if __name__ == "__main__":
    main()
