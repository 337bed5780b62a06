"""The jobs of a sweep: each a run in a process of its own, in one sweep folder.

A job that dies does not affect the others, whatever launches it. It is started by the command that
also reruns it alone: ``python -m experiments.train resume=<run folder>``.
"""

from __future__ import annotations

import filecmp
import hashlib
import logging
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

import hydra
from hydra import initialize_config_dir
from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Quote, QuotedString
from omegaconf import DictConfig

from experiments.configuration import CONF, PRIMARY, parse
from experiments.program import set_up_logging, show_command
from experiments.sweeps.ending import END_CODES, ending_runs, leave_ending_to_sweep
from experiments.sweeps.runs import (
    HARMLESS,
    Run,
    advise,
    count_frames,
    list_arguments,
    list_runs,
    read_run,
)
from experiments.train_settings import TRAINING, TrainConfig, begin_run
from fishrl.training.aliases import update_names
from fishrl.training.description import to_plain
from fishrl.training.progress import Progress
from fishrl.training.run_folder import RunFolder, read_config

logger = logging.getLogger(__name__)

#: Longest name of a run folder before a hash stands in for the rest.
LONGEST_NAME = 100
_LOOK_SECONDS = 0.5


def sweep(arguments: Sequence[str]) -> None:
    """Run a sweep, report on its runs, and end the program with 1 unless all are finished.

    Args:
        arguments: of ``experiments.train``, with ``--multirun``.

    Raises:
        ValueError: for invalid settings of any job.
    """
    overrides = TRAINING.prepare(arguments)
    folder, same = read_common(overrides)
    planned = [name_job(job, same=same) for job in list_jobs(overrides)]
    own = [
        f"++folder={quote(str(folder))}",
        f"hydra.sweep.dir={quote(str(folder))}",
        "hydra.sweep.subdir=.",
        f"hydra.job.config.override_dirname.exclude_keys=[{','.join(same)}]",
    ]
    sys.argv[1:] = ["--multirun", *overrides, *own]
    os.environ["HYDRA_FULL_ERROR"] = "1"  # let hydra raise its errors
    is_cut_off = False
    try:
        with ending_runs():
            hydra.main(version_base="1.3", config_path=str(CONF), config_name=PRIMARY)(run_job)()
    except KeyboardInterrupt:
        is_cut_off = True
        print("\ninterrupted; the same command with the same folder=... goes on", file=sys.stderr)
    runs = [read_run(path) for path in list_runs(folder)]
    if runs:
        print(f"\n{folder}: {advise(runs, planned=planned)}")
        print(f"table and curves: {show_command('experiments.summarize', str(folder))}")
    sys.exit(is_cut_off or any(run.status != "finished" for run in runs))


def read_common(overrides: Sequence[str]) -> tuple[Path, list[str]]:
    """Return the folder of a sweep, and the settings that its jobs have in common.

    Raises:
        ValueError: for settings that every job needs for itself.
    """
    folder = Path("runs") / f"sweep-{time.strftime('%Y%m%d-%H%M%S')}"
    same = ["folder"]
    for override in parse(overrides):
        key = override.key_or_group
        if key in ("name", "resume") or (key == "folder" and override.is_sweep_override()):
            raise ValueError(
                f"{key}: the runs of a sweep lie in one folder=..., are named after what differs, "
                "and go on when the same command is given again"
            )
        if key == "folder":
            folder = Path(str(override.value())).expanduser()
        elif not override.is_sweep_override():
            same.append(key)
    return folder, same


def list_jobs(overrides: Sequence[str]) -> list[list[str]]:
    """Return the overrides of each job, checked once for all seeds.

    Raises:
        ValueError: for invalid settings of any job.
    """
    options = [line for line in overrides if line.startswith("hydra")]
    settings = [line for line in overrides if not line.startswith("hydra")]
    with initialize_config_dir(str(CONF), version_base="1.3"):
        loader = GlobalHydra.instance().config_loader()
        parsed = OverridesParser.create(config_loader=loader).parse_overrides(settings)
        (jobs,) = BasicSweeper.split_arguments(parsed, None)
    for job in {tuple(line for line in job if not line.startswith("++seed=")) for job in jobs}:
        TRAINING.read([*options, *job])
    return [list(job) for job in jobs]


def name_job(overrides: Sequence[str], *, same: Sequence[str] = ()) -> str:
    """Name a run after what distinguishes it from the others of its sweep.

    Args:
        overrides: of the job, ``key=value`` each.
        same: keys that all jobs share.
    """
    parts = []
    for override in overrides:
        key, _, value = override.lstrip("+").partition("=")
        if key not in same:
            key = key.removesuffix("._target_")
            parts.append(re.sub(r"[^A-Za-z0-9.+-]+", "_", f"{key.rsplit('.', 1)[-1]}_{value}"))
    name = "-".join(parts) or "run"
    if len(name) <= LONGEST_NAME:
        return name
    return f"{name[: LONGEST_NAME - 9]}-{hashlib.sha256(name.encode()).hexdigest()[:8]}"


def quote(value: str) -> str:
    """Write a value so that hydra reads it as it is."""
    return QuotedString(value, Quote.single).with_quotes()


def run_job(config: DictConfig) -> None:
    """Run one job of a sweep; hydra's launchers call this, possibly in other processes.

    A finished job is skipped, an unfinished one is resumed. A failure is written to the run's
    folder, where ``experiments.summarize`` finds it, and does not affect other jobs.
    """
    set_up_logging()
    leave_ending_to_sweep()
    options = HydraConfig.get()
    same = list(options.job.config.override_dirname.exclude_keys)
    name = name_job(options.overrides.task, same=same)
    try:
        settings = TRAINING.make(TRAINING.check(config, options.overrides.task))
        folder = find_or_begin(settings, name=name)
    except ValueError as error:
        path = Path(str(config.folder)) / name
        path.mkdir(parents=True, exist_ok=True)
        RunFolder(path).failure.write_text(f"{error}\n", encoding="utf-8")
        logger.info("%s: failed: %s", name, error)
        return
    run = read_run(folder.path)
    if run.status not in ("finished", "running"):
        run = run_alone(folder.path, total_frames=settings.total_frames)
    logger.info("%s: %s%s", folder.path.name, run.status, f": {run.reason}" if run.reason else "")


def find_or_begin(config: TrainConfig, *, name: str) -> RunFolder:
    """Return the folder of the run with these settings, made if there is none.

    Args:
        config: of the run.
        name: of the folder; one with a number behind it if a run with other settings has it.

    Raises:
        ValueError: if it cannot be written.
    """
    config = replace(config, name=name)
    number = 1
    while True:
        path = Path(config.folder).expanduser() / (name if number == 1 else f"{name}-{number}")
        folder = RunFolder(path)
        if not path.exists():
            return begin_run(config, RunFolder.create(parent=config.folder, name=name))
        if folder.config.is_file():
            if is_same(config, folder):
                return folder.checked()
        elif folder.failure.is_file():  # it never began
            folder.failure.unlink()
            return begin_run(config, folder.checked())
        number += 1


def is_same(config: TrainConfig, folder: RunFolder) -> bool:
    """Tell whether a run has these settings, except harmless ones and the classifier's path."""
    stored = update_names(read_config(folder.config))
    wanted = update_names(to_plain(asdict(config)))
    own, given = folder.classifier, Path(wanted["recognition"] or "").expanduser()
    if own.is_file() and given.is_file():
        is_equal = filecmp.cmp(own, given, shallow=False)
        stored["recognition"] = wanted["recognition"] if is_equal else str(own)
    names = (wanted | stored).keys() - set(HARMLESS)
    return all(stored.get(name) == wanted.get(name) for name in names)


def run_alone(path: Path, *, total_frames: int) -> Run:
    """Start or resume a run in a process of its own, and wait for it.

    Its output goes to ``output.log`` in its folder.

    Args:
        path: of its folder.
        total_frames: length of the progress bar.
    """
    arguments = list_arguments(quote(str(path)), read_run(path).config)
    command = [sys.executable, "-m", "experiments.train", *arguments]
    with (
        Progress() as bar,
        (path / "output.log").open("ab") as output,
        subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT) as child,
    ):
        done = count_frames(path)
        bar.start(path.name, total=total_frames, done=done)
        while child.poll() is None:
            time.sleep(_LOOK_SECONDS)
            before, done = done, max(done, count_frames(path))
            bar.advance(done - before)
        bar.advance(max(0, count_frames(path) - done))
    run = read_run(path)
    if run.status == "stopped" and child.returncode not in END_CODES:
        code = child.returncode
        reason = f"killed by {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
        RunFolder(path).failure.write_text(f"{reason}; see output.log\n", encoding="utf-8")
        run = read_run(path)
    return run
