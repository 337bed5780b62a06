"""The jobs of a sweep: each a run in a process of its own, in one sweep folder.

What kills a job kills nothing else, whatever launches it, and a job is started exactly as it is
rerun alone: ``python -m experiments.train resume=<run folder>``.
"""

from __future__ import annotations

import filecmp
import hashlib
import logging
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

from experiments.settings import ConfigError
from experiments.sweeps.ending import (
    TOLD_CODES,
    Terminated,
    ending_runs,
    leave_ending_to_sweep,
)
from experiments.sweeps.runs import HARMLESS, Run, advise, count_frames, list_runs, read_run
from fishrl.training.aliases import update_names
from fishrl.training.progress import Progress
from fishrl.training.run_folder import RunFolder

if TYPE_CHECKING:
    from omegaconf import DictConfig

    from experiments.settings import TrainConfig

logger = logging.getLogger(__name__)

#: Longest name of a run folder before a number stands in for the rest.
LONGEST_NAME = 100
_LOOK_SECONDS = 0.5


def is_sweep(arguments: Sequence[str]) -> bool:
    """Tell whether a command line asks for a sweep."""
    return bool({"--multirun", "-m", "hydra.mode=MULTIRUN"} & set(arguments))


def sweep_arguments(arguments: Sequence[str]) -> tuple[list[str], Path]:
    """Complete the checked command line of a sweep.

    Args:
        arguments: of ``experiments.train``, checked.

    Returns:
        The command line, which names the sweep's folder and what its jobs have in common; and the
        folder.

    Raises:
        ConfigError: for settings that every run of a sweep needs for itself.
    """
    from hydra.core.override_parser.overrides_parser import OverridesParser

    from experiments.search_path import split_arguments

    _, lines = split_arguments(arguments)
    overrides = OverridesParser.create().parse_overrides(lines)
    folder = f"runs/sweep-{time.strftime('%Y%m%d-%H%M%S')}"
    same = ["folder"]
    for override in overrides:
        key = override.key_or_group
        if key in ("name", "resume"):
            raise ConfigError(
                f"{key}=...: the runs of a sweep are named after what differs, and go on when the "
                "same command is given again; leave it away"
            )
        if key == "folder":
            if override.is_sweep_override():
                raise ConfigError("folder=...: a sweep has one folder; give a single one")
            folder = str(override.value())
        elif not override.is_sweep_override():
            same.append(key)
    result = [argument for argument in arguments if not argument.startswith("folder=")]
    result.append(f"folder={quote(folder)}")
    result.append(f"hydra.job.config.override_dirname.exclude_keys=[{','.join(same)}]")
    return result, Path(folder)


def quote(value: str) -> str:
    """Write words as a value that hydra reads as they are."""
    from hydra.core.override_parser.types import Quote, QuotedString

    return QuotedString(value, Quote.single).with_quotes()


def name_job(overrides: Sequence[str], *, same: Sequence[str] = ()) -> str:
    """Name a run after what tells it from the others of its sweep.

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
    if len(name) > LONGEST_NAME:
        rest = hashlib.sha256(name.encode()).hexdigest()[:8]
        name = f"{name[: LONGEST_NAME - 9]}-{rest}"
    return name


def name_jobs(arguments: Sequence[str]) -> list[str]:
    """Name the runs of a sweep in their order; none where hydra alone can list them (``glob(*)``).

    Args:
        arguments: as ``sweep_arguments`` completes them.
    """
    from hydra.core.override_parser.overrides_parser import OverridesParser
    from hydra.core.override_parser.types import Glob

    from experiments.search_path import split_arguments

    _, lines = split_arguments(arguments)
    overrides = OverridesParser.create().parse_overrides(lines)
    swept = [override for override in overrides if override.is_sweep_override()]
    if any(isinstance(o.value(), Glob) or not o.is_discrete_sweep() for o in swept):
        return []
    values = [[f"{o.get_key_element()}={v}" for v in o.sweep_string_iterator()] for o in swept]
    return [name_job(job) for job in product(*values)]


def run_job(config: DictConfig) -> None:
    """Run one job of a sweep; hydra's launchers call this, maybe in other processes.

    A job that is over is left alone, an unfinished one goes on. A failure is written into the run's
    folder, where ``experiments.summarize`` finds it, and is none of the other jobs' business.
    """
    from hydra.core.hydra_config import HydraConfig

    from experiments.command_line import set_up_logging, training_settings

    set_up_logging()
    leave_ending_to_sweep()
    hydra = HydraConfig.get()
    name = name_job(hydra.overrides.task, same=list(hydra.job.config.override_dirname.exclude_keys))
    try:
        settings = training_settings(config)
        folder = find_or_begin(settings, name=name)
    except ValueError as error:
        path = Path(str(config.folder)) / name
        path.mkdir(parents=True, exist_ok=True)
        (path / "failure.txt").write_text(f"{error}\n", encoding="utf-8")
        logger.info("%s: failed: %s", name, error)
        return
    run = read_run(folder.path)
    if run.status not in ("finished", "running"):
        run = run_alone(folder.path, total_frames=settings.total_frames)
    logger.info("%s: %s%s", folder.path.name, run.status, f": {run.reason}" if run.reason else "")


def find_or_begin(config: TrainConfig, *, name: str) -> RunFolder:
    """Return the folder of the run with these settings, made if there is none.

    Args:
        config: of the run; ``name`` is set.
        name: of the folder; one with a number behind it if a run with other settings has it.

    Raises:
        ValueError: if it cannot be written.
    """
    from experiments.train import begin_run

    config.name = name
    number = 1
    while True:
        path = Path(config.folder).expanduser() / (name if number == 1 else f"{name}-{number}")
        if not path.exists():
            return begin_run(config, RunFolder.create(parent=config.folder, name=name))
        if (path / "config.yaml").is_file():
            if find_difference(config, path) is None:
                return RunFolder(path).checked()
        elif (path / "failure.txt").is_file():  # it never began
            (path / "failure.txt").unlink()
            return begin_run(config, RunFolder(path).checked())
        number += 1


def find_difference(config: TrainConfig, path: Path) -> tuple[str, Any, Any] | None:
    """Compare settings with those of the run in a folder, wherever its machine lies.

    Args:
        config: the settings.
        path: of the folder.

    Returns:
        A setting that differs and is not among the harmless ones, its value there and here; None
        if there is none.
    """
    from omegaconf import OmegaConf

    from experiments.config import to_plain

    stored = update_names(OmegaConf.to_container(OmegaConf.load(path / "config.yaml")))
    wanted = update_names(to_plain(config))
    own, given = RunFolder(path).classifier, Path(wanted["recognition"] or "").expanduser()
    if own.is_file() and given.is_file():
        is_equal = filecmp.cmp(own, given, shallow=False)
        stored["recognition"] = wanted["recognition"] if is_equal else str(own)
    for name in wanted | stored:
        if name not in HARMLESS and stored.get(name) != wanted.get(name):
            return name, stored.get(name), wanted.get(name)
    return None


def run_alone(path: Path, *, total_frames: int, progress: Progress | None = None) -> Run:
    """Begin a run, or go on with it, in a process of its own; wait for it and say how it fared.

    What it prints goes to ``output.log`` in its folder.

    Args:
        path: of its folder.
        total_frames: that it trains for.
        progress: the bar; by default one of its own.
    """
    command = [sys.executable, "-m", "experiments.train", f"resume={quote(str(path))}"]
    with (
        progress or Progress() as bar,
        (path / "output.log").open("ab") as output,
        subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT) as child,
    ):
        done = count_frames(path)
        bar.start(path.name, total=total_frames, done=done)
        try:
            while child.poll() is None:
                time.sleep(_LOOK_SECONDS)
                before, done = done, max(done, count_frames(path))
                bar.advance(done - before)
        except Terminated as end:
            if child.pid not in end.told:  # it has hardly begun; else it saves, and is waited for
                child.send_signal(end.number)
            raise
        bar.advance(max(0, count_frames(path) - done))
    run = read_run(path)
    if run.status == "stopped" and child.returncode not in TOLD_CODES:
        (path / "failure.txt").write_text(f"{_say_end(child.returncode)}\n", encoding="utf-8")
        run = read_run(path)
    return run


def sweep(launch: Callable[[], Any]) -> None:
    """Run a sweep, say how its runs fared, and end the program with 1 unless all are finished.

    Args:
        launch: hydra's program around ``run_job``, which reads the command line.
    """
    from experiments.command_line import plain_errors, show_command

    with plain_errors():
        sys.argv[1:], folder = sweep_arguments(sys.argv[1:])
    folder, planned = folder.expanduser(), name_jobs(sys.argv[1:])
    runs: list[Run] = []
    is_cut_off = False
    try:
        with ending_runs(folder):
            launch()
    except KeyboardInterrupt:
        is_cut_off = True
        print("\ninterrupted; the same command with the same folder=... goes on", file=sys.stderr)
    finally:
        runs = [read_run(path) for path in list_runs(folder)]
        if runs:
            print(f"\n{folder}: {advise(runs, planned=planned)}")
            print(f"table and curves: {show_command('experiments.summarize', str(folder))}")
    sys.exit(is_cut_off or any(run.status != "finished" for run in runs))


def _say_end(code: int) -> str:
    """Say what a process ended with that left no word."""
    if code < 0:
        return f"killed by {signal.Signals(-code).name}"
    return f"ended with exit code {code}; see output.log"
