"""The jobs of a sweep or a search: each a run in a process of its own, all in one folder.

The folder of every run is made first. Each is then started by the command that also resumes it
alone, ``fishrl train resume=<run folder>``, so a job that dies does not affect the
others, whatever launches it.
"""

from __future__ import annotations

import filecmp
import hashlib
import itertools
import json
import logging
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Collection, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import hydra
from hydra import initialize_config_dir
from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import DictConfig

from fishrl.programs.configuration import CONF, PRIMARY, parse, quote
from fishrl.programs.program import set_up_logging, show_command
from fishrl.programs.sweeps.ending import ending_runs, leave_ending_to_sweep
from fishrl.programs.sweeps.runs import (
    HARMLESS,
    Run,
    advise,
    count_frames,
    list_arguments,
    read_run,
)
from fishrl.programs.train_settings import TRAINING, TrainConfig, make_plan
from fishrl.training.classifier import find_classifier
from fishrl.training.description import to_plain
from fishrl.training.interruption import SIGNALS
from fishrl.training.plan import Plan
from fishrl.training.progress import Progress
from fishrl.training.run_folder import RunFolder, read_config
from fishrl.training.runs import make_folder

logger = logging.getLogger(__name__)

#: Longest name of a run folder before a hash stands in for the rest.
LONGEST_NAME = 100
LOOK_SECONDS = 0.5


def sweep(arguments: Sequence[str]) -> None:
    """Run a sweep, report on its runs, and end the program with 1 unless all are finished."""
    jobs = plan_jobs(arguments)
    folder = Path(jobs[0][1].folder).expanduser()
    given = {override.key_or_group for override in parse(TRAINING.prepare(arguments))}
    begun = []
    for name, settings in jobs:
        try:
            run = find_or_begin(settings, name=name)
            begun.append(shlex.join([str(run.path), *list_changes(run, settings, given)]))
        except ValueError as error:
            logger.info("%s: failed: %s", name, error)
    places = [find_place(settings, name=name).path for name, settings in jobs]
    command = f"{show_command('train', *arguments)}\n"
    (folder / "command.txt").write_text(command, encoding="utf-8")
    options = [line for line in TRAINING.prepare(arguments) if line.startswith("hydra")]
    options += [f"hydra.sweep.dir={quote(str(folder))}", "hydra.sweep.subdir=."]
    sys.argv[1:] = ["--multirun", *options, f"++resume={','.join(map(quote, begun))}"]
    os.environ["HYDRA_FULL_ERROR"] = "1"  # let hydra raise its errors
    is_cut_off = False
    try:
        with ending_runs():
            if begun:
                hydra.main(version_base="1.3", config_path=str(CONF), config_name=PRIMARY)(
                    run_job
                )()
    except KeyboardInterrupt:
        is_cut_off = True
        print("\ninterrupted; the same command with the same folder=... goes on", file=sys.stderr)
    runs = [read_run(place) for place in places]
    print(f"\n{folder}: {advise(runs)}")
    print(f"table and curves: {show_command('summarize', str(folder))}")
    sys.exit(int(is_cut_off or any(run.status != "finished" for run in runs)))


def plan_jobs(arguments: Sequence[str]) -> list[tuple[str, TrainConfig]]:
    """Return name and settings of each job of a sweep; raise ValueError for wrong ones of any."""
    overrides = TRAINING.prepare(arguments)
    options = [line for line in overrides if line.startswith("hydra")]
    settings = [line for line in overrides if line not in options]
    keys = {override.key_or_group: override.is_sweep_override() for override in parse(settings)}
    if "name" in keys or "resume" in keys or keys.get("folder"):
        raise ValueError(
            "name, resume, folder: the runs of a sweep lie in one folder=..., are named after what "
            "differs, and go on when the same command is given again"
        )
    if "folder" not in keys:
        settings.append(f"++folder=runs/sweep-{time.strftime('%Y%m%d-%H%M%S')}")
    with initialize_config_dir(str(CONF), version_base="1.3"):
        loader = GlobalHydra.instance().config_loader()
        parsed = OverridesParser.create(config_loader=loader).parse_overrides(settings)
        (jobs,) = BasicSweeper.split_arguments(parsed, None)
    same = set(jobs[0]).intersection(*jobs)
    return [
        (name_job([line for line in job if line not in same]), TRAINING.read([*options, *job]))
        for job in jobs
    ]


def name_job(overrides: Sequence[str]) -> str:
    """Name a run after the ``key=value`` that distinguish it from the others of its sweep."""
    parts = []
    for override in overrides:
        key, _, value = override.lstrip("+").partition("=")
        last = key.removesuffix("._target_").rsplit(".", 1)[-1]
        parts.append(re.sub(r"[^A-Za-z0-9.+-]+", "_", f"{last}_{value}"))
    name = "-".join(parts) or "run"
    if len(name) <= LONGEST_NAME:
        return name
    return f"{name[: LONGEST_NAME - 9]}-{hashlib.sha256(name.encode()).hexdigest()[:8]}"


def run_job(config: DictConfig) -> None:
    """Run one job unless it is finished; hydra's launchers call this, also in other processes."""
    set_up_logging()
    leave_ending_to_sweep()
    path, *changes = shlex.split(config.resume)
    run = read_run(Path(path))
    if run.status != "running" and (changes or run.status != "finished"):
        run = run_alone(run.path, *changes)
    logger.info("%s: %s%s", run.path.name, run.status, f": {run.reason}" if run.reason else "")


def find_or_begin(config: TrainConfig, *, name: str) -> RunFolder:
    """Return the folder of the run with these settings, made if there is none.

    A number follows the name if a run with other settings has it. Raise ValueError, and note it in
    the folder, if the run cannot be set up.
    """
    config = replace(config, name=name)
    folder = find_place(config, name=name)
    if folder.config.is_file():
        return folder.checked()
    if not folder.path.exists():
        folder = RunFolder.create(parent=config.folder, name=folder.path.name)
    with folder.checked().noting_failure():
        plan = make_plan(config)
        return make_folder(plan, recognition=config.recognition, folder=folder)[0]


def find_place(config: TrainConfig, *, name: str) -> RunFolder:
    """Return the folder of the run with these settings, or where it is to begin."""
    for number in itertools.count(1):
        path = Path(config.folder).expanduser() / (name if number == 1 else f"{name}-{number}")
        folder = RunFolder(path)
        if folder.config.is_file():
            if is_same(config, folder):
                break
        elif folder.failure.is_file() or not path.exists():  # it never began
            break
    return folder


def find_runs(arguments: Sequence[str]) -> list[Path]:
    """Return the folders of those runs of a sweep that have begun."""
    places = [find_place(settings, name=name) for name, settings in plan_jobs(arguments)]
    return sorted(place.path for place in places if place.config.is_file())


def is_same(config: TrainConfig, folder: RunFolder) -> bool:
    """Tell whether a run has these settings, except harmless ones and the classifier's path."""
    try:  # as plans, so that settings that a stored run does not know have their defaults
        wanted = make_plan(config).to_config() | {"recognition": config.recognition}
        stored = Plan.from_config(read_config(folder.config)).to_config()
    except ValueError:  # no run has settings that cannot be
        return False
    own = folder.classifier
    given = Path(find_classifier(wanted["recognition"], folder.path) or "").expanduser()
    if own.is_file() and given.is_file():
        is_equal = filecmp.cmp(own, given, shallow=False)
        stored["recognition"] = wanted["recognition"] if is_equal else str(own)
    names = (wanted | stored).keys() - set(HARMLESS)
    return all(stored.get(name) == wanted.get(name) for name in names)


def list_changes(folder: RunFolder, config: TrainConfig, given: Collection[str]) -> list[str]:
    """Return those of the given harmless settings that are others in a run, as ``key=value``."""
    stored, wanted = read_config(folder.config), to_plain(asdict(config))
    names = [name for name in HARMLESS if name in given and name != "folder"]
    return [f"{n}={json.dumps(wanted[n])}" for n in names if stored.get(n) != wanted[n]]


def run_alone(path: Path, *changes: str) -> Run:
    """Start or resume a run in a process of its own and wait for it; it prints to output.log."""
    run = read_run(path)
    arguments = [*list_arguments(path, run.config), *changes]
    command = [sys.executable, "-m", "fishrl", "train", *arguments]
    with (
        Progress() as bar,
        (path / "output.log").open("ab") as output,
        subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT) as child,
    ):
        done = run.frames
        bar.start(path.name, total=run.config["total_frames"], done=done)
        is_over = False
        while not is_over:
            time.sleep(LOOK_SECONDS)
            is_over = child.poll() is not None
            before, done = done, max(done, count_frames(path))
            bar.advance(done - before)
    run = read_run(path)
    code = child.returncode
    if run.status == "stopped" and code not in [128 + number for number in SIGNALS]:
        reason = f"killed by {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
        RunFolder(path).failure.write_text(f"{reason}; see output.log\n", encoding="utf-8")
    return read_run(path)
