"""The jobs of a sweep: each a run in a process of its own, all in one folder.

hydra launches them, here or elsewhere. A job is the command ``fishrl train <its settings>
name=<what differs>``, which begins the run or continues it, so a job that dies does not affect the
others, and the same sweep continues those that are unfinished.
"""

import hashlib
import itertools
import logging
import multiprocessing
import os
import re
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

from hydra import compose
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import DictConfig

from fishrl.children import start_child
from fishrl.files import write_whole
from fishrl.locks import take_lock
from fishrl.programs.configuration import parse, quote, run_hydra, split_options
from fishrl.programs.program import set_up_logging, show_command
from fishrl.programs.sweeps.ending import ending_runs, leave_ending_to_sweep
from fishrl.programs.sweeps.runs import Run, advise, count_frames, is_held, read_run
from fishrl.programs.train_settings import TRAINING, TrainConfig
from fishrl.training.interruption import SIGNALS
from fishrl.training.opening import open_run
from fishrl.training.progress import Progress
from fishrl.training.run_folder import RunFolder, naming_folder

logger = logging.getLogger(__name__)

#: Longest name of a run folder before a hash stands in for the rest.
LONGEST_NAME = 100
LOOK_SECONDS = 0.5


class Job(NamedTuple):
    """A run of a sweep: its settings, and the words after ``fishrl train`` that make it."""

    settings: TrainConfig
    words: list[str]

    @property
    def path(self) -> Path:
        """The run folder."""
        return Path(str(self.settings.path))


@dataclass(frozen=True)
class Launch:
    """Runs a job of a sweep; hydra's launchers call it, also in other processes."""

    options: tuple[str, ...]  #: words of every job, for its YAML files
    swept: frozenset[str]  #: keys that differ between jobs
    shared: frozenset[str] = frozenset()  #: names that several jobs would have

    def name(self, overrides: Sequence[str]) -> str:
        """Return the name of the job with these overrides, after the swept ones."""
        own = [line for line in overrides if line.partition("=")[0] in self.swept]
        return _add_hash(name, str(own)) if (name := name_job(own)) in self.shared else name

    def plan(self, overrides: Sequence[str]) -> Job:
        """Return the job with these overrides."""
        words = [*self.options, *overrides, f"name={self.name(overrides)}"]
        return Job(TRAINING.read(words), words)

    def __call__(self, config: DictConfig) -> None:
        """Run the job that hydra has composed."""
        with set_up_logging():
            leave_ending_to_sweep()
            overrides = list(HydraConfig.get().overrides.task)
            GlobalHydra.instance().clear()  # to read the command line of the job as the job will
            run = run_job(self.plan(overrides))
            logger.info(
                "%s: %s%s", run.path.name, run.status, f": {run.reason}" if run.reason else ""
            )


def sweep(arguments: Sequence[str]) -> None:
    """Run a sweep, report on its runs, and end the program with 1 unless all are finished."""
    launch, jobs = plan_jobs(arguments)
    if (parent := jobs[0].settings.folder) == TRAINING.list_defaults()["folder"]:
        name = f"sweep-{time.strftime('%Y%m%d-%H%M%S')}"
        own = RunFolder.create(parent=parent, name=name).path  # no other sweep's of this second
        arguments = [*arguments, f"folder={quote(str(own))}"]
        launch, jobs = plan_jobs(arguments)
    for job in jobs:
        open_run(job.settings)  # refuses settings that its run does not have
    folder = Path(jobs[0].settings.folder).expanduser()
    with naming_folder(folder):
        folder.mkdir(parents=True, exist_ok=True)
        write_whole(folder / "command.txt", f"{show_command('train', *arguments)}\n")
    is_cut_off = False
    try:
        with ending_runs():
            run_hydra(launch, TRAINING.name, ["--multirun", *TRAINING.prepare(arguments)])
    except KeyboardInterrupt:
        is_cut_off = True
        print("\ninterrupted; the same command with the same folder=... continues", file=sys.stderr)
    runs = [read_run(job.path) for job in jobs]
    print(f"\n{folder}: {advise(runs, modules=jobs[0].settings.modules)}")
    print(f"table and curves: {show_command('summarize', str(folder))}")
    sys.exit(int(is_cut_off or any(run.status != "finished" for run in runs)))


def find_runs(arguments: Sequence[str]) -> list[Path]:
    """Return the folders of the runs of a sweep that have begun."""
    paths = (job.path for job in plan_jobs(arguments)[1])
    return sorted(path for path in paths if RunFolder(path).config.is_file())


def plan_jobs(arguments: Sequence[str]) -> tuple[Launch, list[Job]]:
    """Return the jobs of a sweep in hydra's order; raise ValueError for wrong settings of any."""
    overrides = TRAINING.prepare(arguments)
    own = [line for line in overrides if not re.match("hydra[./]", line)]
    swept = {each.input_line for each in parse(own) if each.is_sweep_override()}
    with TRAINING.use_hydra():
        fixed = [line for line in overrides if line not in swept]
        one = compose(TRAINING.name, fixed, return_hydra_config=True)
        own = [f"{key}={value}" for key, value in (one.hydra.sweeper.params or {}).items()] + own
        parser = OverridesParser.create(config_loader=GlobalHydra.instance().config_loader())
        given = {each.get_key_element(): each for each in parser.parse_overrides(own)}
        choices = {
            key: [*each.sweep_string_iterator()]
            if each.is_sweep_override()
            else [each.get_value_element_as_str()]
            for key, each in given.items()
        }
    keys = frozenset(key for key, each in given.items() if each.is_sweep_override())
    if {"name", "resume"} & given.keys() or "folder" in keys:
        raise ValueError(
            "name, resume, folder: a sweep sets name and resume itself; give one folder=..., and "
            "the same command again to continue"
        )
    folder = split_options(arguments).config_dir
    launch = Launch(() if folder is None else ("--config-dir", folder), keys)
    lines = [[f"{key}={value}" for value in values] for key, values in choices.items()]
    every = [*dict.fromkeys(itertools.product(*lines))]
    if not every:
        raise ValueError("a setting has no values to sweep over")
    names = Counter(map(launch.name, every))
    launch = replace(launch, shared=frozenset(name for name in names if names[name] > 1))
    return launch, [launch.plan(job) for job in every]


def name_job(overrides: Sequence[str]) -> str:
    """Name a run after the ``key=value`` in which the runs of a sweep differ."""
    parts = []
    for override in overrides:
        key, _, value = override.lstrip("+").partition("=")
        last = key.removesuffix("._target_").rsplit(".", 1)[-1]
        parts.append(re.sub(r"[^A-Za-z0-9.+-]+", "_", f"{last}_{value}"))
    name = "-".join(parts) or "run"
    return name if len(name) <= LONGEST_NAME else _add_hash(name, name)


def _add_hash(name: str, of: str) -> str:
    return f"{name[: LONGEST_NAME - 9]}-{hashlib.sha256(of.encode()).hexdigest()[:8]}"


def run_job(job: Job) -> Run:
    """Begin or continue a run in a process of its own and wait for it; it prints to output.log.

    A run that is finished, or that another process writes, is left alone. Raise ValueError if the
    run has other settings, whoever writes it.
    """
    path = job.path
    if open_run(job.settings).summary is not None:
        return read_run(path)
    path.mkdir(parents=True, exist_ok=True)
    folder = RunFolder(path)
    start = "import sys; del sys.argv[1]; from fishrl.__main__ import main; main()"
    words = ("fishrl", "train", *job.words)  # as ``find_trainings`` looks for
    is_of_joblib, parent = multiprocessing.parent_process() is not None, os.getppid()
    with (
        Progress() as bar,
        (path / "output.log").open("ab") as output,
        ExitStack() as stack,
    ):
        # held by this job and its run: another sweep's job of the same folder begins no second one
        while not (is_own := take_lock(output)) and not folder.config.is_file():
            time.sleep(LOOK_SECONDS)
        is_ended = open_run(job.settings).summary is not None  # it may have begun meanwhile
        if is_ended or not is_own or is_held(path):
            return read_run(path)
        child = stack.enter_context(
            start_child(start, *words, stdout=output, stderr=subprocess.STDOUT)
        )
        done = count_frames(path)
        bar.on_phase(path.name, total=job.settings.total_frames, done=done)
        is_over = False
        while not is_over:
            time.sleep(LOOK_SECONDS)
            if is_of_joblib and os.getppid() != parent:  # the sweep was killed
                os._exit(1)  # and the run ends with this process
            is_over = child.poll() is not None
            before, done = done, max(done, count_frames(path))
            bar.on_progress(done - before)
    code, is_named = child.returncode, folder.failure.is_file() or is_held(path)
    if code and code not in [128 + number for number in SIGNALS] and not is_named:
        reason = f"exit code {code}; see output.log"
        if code < 0:
            reason = f"killed by {signal.Signals(-code).name}; see output.log"
        elif lines := (path / "output.log").read_text(encoding="utf-8").strip().splitlines():
            reason = lines[-1].removeprefix("error: ")
        write_whole(folder.failure, f"{reason}\n")
    return read_run(path)
