"""Search for good settings with Optuna: ``fishrl search folder=runs/search ...``.

What is searched is written ``gamma=interval(0.9,1)``, ``learning_rate=tag(log,interval(a,b))``,
``batch_size=int(interval(16,128))`` or ``hidden=choice([64],[64,64])``; other settings are those
of every trial, as for ``fishrl train``. Each trial trains as a job of a sweep does. The study
lies in ``study.db`` in the folder: the same command continues it, an interrupted or killed trial
first; started several times at once, it searches with several processes.
"""

import logging
import sqlite3
import sys
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from hydra.core.override_parser.types import IntervalSweep
from pydantic import PositiveInt

try:
    import optuna
except ImportError:  # it comes with the extra `sweep`
    optuna = None

from fishrl.extras import show_install
from fishrl.files import make_folder
from fishrl.locks import take_lock
from fishrl.pages import show
from fishrl.programs.configuration import parse, quote
from fishrl.programs.program import program, show_command
from fishrl.programs.sweeps.ending import ending_runs
from fishrl.programs.sweeps.jobs import LOOK_SECONDS, Job, run_job
from fishrl.programs.train_settings import TRAINING
from fishrl.settings import Settings
from fishrl.training.run_folder import HeldError, RunFolder

logger = logging.getLogger(__name__)


class SearchSettings(Settings):
    """Settings of a search, in addition to the settings of its trainings.

    Args:
        folder: folder of the study and its runs.
        trials: number of trials in the study, including failed ones and those of other processes.
        seeds: runs per trial, over which the metric is averaged.
        metric: entry of ``summary.json`` to optimise.
        minimize: minimise the metric instead of maximising it.
        overrides: settings of the trainings; on the command line, all keys not listed here.
    """

    folder: str
    trials: PositiveInt = 20
    seeds: PositiveInt = 1
    metric: str = "mean_return"
    minimize: bool = False
    overrides: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check that something is searched, and all that is searched."""
        for override in parse(TRAINING.prepare(self.overrides)):
            if override.key_or_group in ("seed", "name", "resume", "folder"):
                raise ValueError(f"{override.key_or_group}: is set by the search; leave it out")
        space = self.space()
        if not space:
            raise ValueError("nothing to search: give a setting as key=interval(low,high)")
        some = {k: d.choices[0] if hasattr(d, "choices") else d.low for k, d in space.items()}
        TRAINING.read([*self.fixed, *(f"{key}={value}" for key, value in some.items())])

    @property
    def path(self) -> Path:
        """The folder of the study and its runs."""
        return Path(self.folder).expanduser()

    @property
    def fixed(self) -> list[str]:
        """The settings that every trial shares, as hydra reads them."""
        lines = TRAINING.prepare(self.overrides)
        searched = {o.input_line for o in parse(lines) if o.is_sweep_override()}
        return [line for line in lines if line not in searched]

    def space(self) -> dict[str, Any]:
        """Return Optuna's distribution of each setting that is searched."""
        if optuna is None:
            raise ImportError(f"the search needs Optuna: {show_install('sweep')}")
        made: Any = optuna.distributions
        space: dict[str, Any] = {}
        for override in parse(TRAINING.prepare(self.overrides)):
            key, value = override.get_key_element(), override.value()
            if isinstance(value, IntervalSweep):
                is_whole = isinstance(value.start, int) and isinstance(value.end, int)
                kind = made.IntDistribution if is_whole else made.FloatDistribution
                space[key] = kind(value.start, value.end, log="log" in value.tags)
            elif override.is_sweep_override():
                choices = list(override.sweep_string_iterator())
                space[key] = made.CategoricalDistribution(choices)
        return space


def open_study(settings: SearchSettings) -> Any:
    """Return Optuna's study of a search, new or with the trials of before.

    Raises:
        ValueError: if its folder holds another search, with results.
    """
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    folder, space = settings.path, settings.space()
    file = make_folder(folder).resolve() / "study.db"
    connect = {"creator": partial(sqlite3.connect, file)}  # a URL would read %, ? and # in a path
    study = optuna.create_study(
        storage=optuna.storages.RDBStorage("sqlite://", engine_kwargs=connect),
        study_name="search",
        direction="minimize" if settings.minimize else "maximize",
        load_if_exists=True,
    )
    ranges = {key: str(distribution) for key, distribution in space.items()}
    identity = str([settings.fixed, ranges, settings.metric, settings.seeds, settings.minimize])
    has_begun = any(trial.value is not None for trial in study.trials)
    if has_begun and study.user_attrs.get("identity", identity) != identity:
        raise ValueError(f"{folder}: holds another search, {study.user_attrs['identity']!r}")
    study.set_user_attr("identity", identity)
    return study


def search(settings: SearchSettings) -> Any:
    """Run trials until the study has as many as wanted, those that were cut off first."""
    study = open_study(settings)
    for trial in study.get_trials(states=[optuna.trial.TrialState.RUNNING]):
        run_trial(settings, study, trial.number)
    while len(study.trials) < settings.trials:
        # Each trial has its own seed, also where several processes search: nothing is drawn twice.
        with (settings.path / "study.lock").open("a") as held:
            take_lock(held, waits=True, is_passed_on=True)
            study.sampler = optuna.samplers.TPESampler(seed=len(study.trials))
            number = study.ask(settings.space()).number
        try:
            run_trial(settings, study, number)
        except optuna.exceptions.UpdateFinishedTrialError:
            logger.info("another search began meanwhile and gave the new trial up")
    return study


def run_trial(settings: SearchSettings, study: Any, number: int) -> None:
    """Train with the settings of a trial, unless another process is at it or has done it."""
    place = RunFolder(settings.path / ".trials" / f"{number:04d}")
    place.path.mkdir(parents=True, exist_ok=True)
    try:
        held = place.hold()
    except HeldError:
        return
    with held:
        trial = study.trials[number]  # read again: another process may just have finished it
        if trial.state != optuna.trial.TrialState.RUNNING:
            return
        chosen = [f"{key}={value}" for key, value in trial.params.items()]
        # else killed before it was begun, or not of this search
        is_whole = trial.distributions == settings.space()
        seeds = range(settings.seeds) if is_whole else ()
        values: list[Any] = [run_seed(settings, number, chosen, seed) for seed in seeds]
        if not values or None in values:
            study.tell(number, state=optuna.trial.TrialState.FAIL)
            return
        study.tell(number, sum(values) / len(values))
        logger.info("trial %d: %s: %g", number, " ".join(chosen), sum(values) / len(values))


def run_seed(
    settings: SearchSettings, number: int, chosen: Sequence[str], seed: int
) -> float | None:
    """Run one seed of a trial, or read its result; None if it failed."""
    name = f"trial_{number:04d}-seed_{seed}"
    place = [f"seed={seed}", f"folder={quote(settings.folder)}", f"name={name}"]
    words = [*settings.fixed, *chosen, *place]
    try:
        job = Job(TRAINING.read(words), words)
        while (run := run_job(job)).status == "running":  # as one that outlived its search
            time.sleep(LOOK_SECONDS)
    except ValueError as error:
        logger.info("%s: failed: %s", name, error)
        return None
    if run.status != "finished":
        logger.info("%s: %s: %s", name, run.status, run.reason)
        return None
    if settings.metric not in run.summary:
        numbers = sorted(k for k, v in run.summary.items() if isinstance(v, int | float))
        raise ValueError(f"metric = {settings.metric}: not in {run.path}; there is {numbers}")
    value = run.summary[settings.metric]
    return None if value is None else float(value)


@program(SearchSettings, others="overrides")
def main(settings: SearchSettings) -> None:
    """Search, and print the best trials."""
    try:
        with ending_runs():
            study = search(settings)
    except KeyboardInterrupt:
        sys.exit("interrupted; the same command continues")
    done = [trial for trial in study.trials if trial.value is not None]
    print(f"\n{len(done)} of {len(study.trials)} trials finished in {settings.folder}")
    for trial in sorted(done, key=lambda t: t.value, reverse=not settings.minimize)[:5]:
        chosen = show(" ".join(f"{key}={value}" for key, value in trial.params.items()))
        print(f"  trial {trial.number:<4} {settings.metric} {trial.value:<12.6g} {chosen}")
    print(f"table and curves: {show_command('summarize', settings.folder)}")
