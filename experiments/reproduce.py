"""Reproduce the paper's tables and figures: ``python -m experiments.reproduce scale=small``.

``scale=half`` and ``scale=paper`` do the same on finer grids. Each stage is another program, run by
the command that is printed. The same command continues after an interruption, also ``kill -9``;
finished stages are repeated only if their settings change. ``plan=true`` lists the remaining ones.
Tables and figures are written to ``reproduction.md`` and ``reproduction.html`` in the folder.
"""

import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import Field, NonNegativeFloat, NonNegativeInt, PositiveFloat, PositiveInt

from experiments.benchmarks.machine import describe_machine
from experiments.paper import find_fitted, write_page
from fishrl.__main__ import list_programs
from fishrl.locks import take_lock
from fishrl.programs.configuration import quote
from fishrl.programs.program import program, show_command
from fishrl.programs.sweeps.jobs import find_runs
from fishrl.programs.sweeps.runs import read_run
from fishrl.programs.train_settings import TRAINING
from fishrl.settings import Settings
from fishrl.training.recognition import FILE
from fishrl.training.run_folder import Stored, read_plain, write_json

#: Settings of the trainings of each arm, in addition to the settings of the scale. Without rows of
#: frequencies, a flow label is useful only to a policy that observes it.
ARM_SETTINGS = {
    "both": ("{recognition}",),
    "macro_actions": (),
    "lateral_line": (
        *("task=karman_gait_direct", "{recognition}"),
        "task.observes=[place,drift,water_velocity,tail_beat,flow_label]",
    ),
    "ablation": ("task=karman_gait_direct",),
}


class Scale(Settings):
    """Settings of the programs at one scale.

    Args:
        name: name of the scale.
        predation: settings of ``train`` for the first task.
        gait: settings of ``train`` for the second task.
        lateral_line: settings of ``train-lateral-line``.
        swimmer: settings of ``validate``.
        seeds: seeds of the trainings.
        episodes: episodes of each policy in each stream.
        periods: duration of an episode, T.
        free_episodes: episodes in each stream without the half disc.
    """

    name: str
    predation: tuple[str, ...] = ()
    gait: tuple[str, ...] = ()
    lateral_line: tuple[str, ...] = ()
    swimmer: tuple[str, ...] = ()
    seeds: Annotated[tuple[NonNegativeInt, ...], Field(min_length=1)] = (0,)
    episodes: PositiveInt = 34
    periods: PositiveFloat = 100.0
    free_episodes: PositiveInt = 4


class ReproduceSettings(Settings):
    """Settings of a reproduction.

    Args:
        scale: what is run; ``scale.<entry>=<value>`` changes an entry.
        folder: folder for runs, tables and figures; by default runs/reproduction-<scale>.
        plan: list the remaining stages without running them.
    """

    scale: Scale
    folder: str | None = None
    plan: bool = False

    @property
    def path(self) -> Path:
        """The folder for runs, tables and figures."""
        return Path(self.folder or f"runs/reproduction-{self.scale.name}")


@dataclass(frozen=True, kw_only=True)
class Stage:
    """A program to run."""

    name: str  #: name of the stage
    words: tuple[str, ...]  #: program and settings
    num_runs: int = 0  #: runs of a training, one per seed


def plan_training(name: str, settings: Sequence[str], scale: Scale, folder: Path) -> Stage:
    """Return the stage that trains a policy with each seed; ValueError for wrong settings."""
    TRAINING.read(settings)
    seeds = f"seed={','.join(map(str, scale.seeds))}"
    words = ("train", "--multirun", *settings, seeds, f"folder={quote(str(folder / name))}")
    return Stage(name=name, words=words, num_runs=len(scale.seeds))


def list_stages(scale: Scale, folder: Path) -> Iterator[Stage]:
    """Yield all stages in order; later stages use the results of earlier ones in the folder.

    Raises:
        ValueError: for invalid settings of a training.
    """
    words = ("validate", "cases=[swimmer]", *scale.swimmer, f"folder={quote(f'{folder}/swimmer')}")
    yield Stage(name="swimmer", words=words)
    yield plan_training("predation", scale.predation, scale, folder)
    yield Stage(
        name="classifier",
        words=(
            *("train-lateral-line", *scale.lateral_line),
            *(f"folder={quote(str(folder))}", "name=classifier"),
        ),
    )
    fitted = find_fitted(folder)
    path = fitted and quote(f"{fitted}/{FILE}")  # settings are read before
    recognition = f"recognition.path={path}" if path else "recognition=oracle"
    trained: list[Path] = []
    for arm, settings in ARM_SETTINGS.items():
        words = tuple(word.format(recognition=recognition) for word in settings)
        stage = plan_training(arm, [*scale.gait, *words], scale, folder)
        yield stage
        trained += find_runs(stage.words[2:]) if (folder / arm).is_dir() else []
    yield Stage(
        name="transfer",
        words=(
            *("transfer", f"runs=[{','.join(quote(str(run)) for run in trained)}]"),
            "baselines=[pid,shedding]",
            *(f"episodes={scale.episodes}", f"periods={scale.periods:g}"),
            *(f"free_episodes={scale.free_episodes}", f"folder={quote(f'{folder}/transfer')}"),
        ),
    )


class Entry(Stored):
    """A stage that has run, in ``stages.json``."""

    words: Annotated[list[str], Field(min_length=1)]
    seconds: NonNegativeFloat
    is_finished: bool
    machine: dict[str, str | int | None]  #: cpu, cores, gpu and torch


class Record:
    """The stages that have run in a folder, stored in ``stages.json``."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "stages.json"
        self.stages: dict[str, Entry] = {}
        if self.path.is_file():
            what = "the record of a reproduction"
            self.stages = read_plain(self.path, dict[str, Entry], what=what)

    def is_finished(self, stage: Stage) -> bool:
        """Return whether a stage is finished with these settings and its runs exist."""
        entry = self.stages.get(stage.name)
        if entry is None or not entry.is_finished or entry.words != list(stage.words):
            return False
        runs = find_runs(stage.words[2:]) if stage.num_runs else []
        return sum(read_run(run).status == "finished" for run in runs) == stage.num_runs

    def note(self, stage: Stage, *, seconds: float, is_finished: bool) -> None:
        """Add to the time that a stage has taken."""
        entry, words, machine = self.stages.get(stage.name), list(stage.words), describe_machine()
        if entry is not None and entry.words == words:
            seconds += entry.seconds
        named = {name: machine[name] for name in ("cpu", "cores", "gpu", "torch")}
        self.stages[stage.name] = Entry(
            words=words, seconds=seconds, is_finished=is_finished, machine=named
        )
        write_json(self.path, self.stages)


@contextmanager
def alone(folder: Path) -> Iterator[int]:
    """Hold a folder until the block and all processes started in it have ended; yield the lock."""
    with (folder / "lock").open("a") as file:
        take_lock(file, waits=True)
        yield file.fileno()


def run_stage(stage: Stage, record: Record, lock: int) -> None:
    """Run a stage; ValueError if it fails."""
    name, *words = stage.words
    command = ["fishrl", name] if name in list_programs() else [f"experiments.{name}"]
    print(f"\n{show_command(command[-1], *words)}", flush=True)
    began = time.monotonic()
    child = subprocess.Popen([sys.executable, "-m", *command, *words], pass_fds=[lock])
    try:
        child.wait()
    except KeyboardInterrupt:
        child.terminate()  # it saves first
        child.wait()
        raise
    finally:
        record.note(stage, seconds=time.monotonic() - began, is_finished=child.returncode == 0)
    if child.returncode:
        raise ValueError(f"{stage.name} ended with status {child.returncode}; repeat the command")


@program(groups={"scale": "small"}, conf=Path(__file__).parent / "conf")
def main(settings: ReproduceSettings) -> None:
    """Run the remaining stages and write the page."""
    scale, folder = settings.scale, settings.path
    folder.mkdir(parents=True, exist_ok=True)
    with alone(folder) as lock:
        record = Record(folder)
        left = [stage.name for stage in list_stages(scale, folder) if not record.is_finished(stage)]
        print(f"left: {', '.join(left) or 'nothing'}")
        if settings.plan:
            return
        for stage in list_stages(scale, folder):
            if not record.is_finished(stage):
                run_stage(stage, record, lock)
        print(f"written: {write_page(folder, record.stages, scale)}")


if __name__ == "__main__":
    main()
