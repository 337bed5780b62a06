"""Runs as read from their folders: settings, results, status, and the command that resumes each."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fishrl.locks import take_lock
from fishrl.programs.configuration import quote
from fishrl.programs.program import show_command
from fishrl.training.logger import read_rows
from fishrl.training.run_folder import RunFolder, read_config, read_summary


@dataclass(frozen=True, kw_only=True)
class Run:
    """One run, as read from its folder."""

    path: Path  #: its folder
    status: str  #: ``finished``, ``running``, ``failed`` (with a reason) or ``stopped``
    reason: str  #: error that ended it, or that followed its end, in one line
    frames: int  #: frames done, according to ``metrics.csv``
    config: dict[str, Any]  #: its settings; empty if they were invalid
    summary: dict[str, Any]  #: results of a finished run; otherwise empty

    @property
    def seed(self) -> str:
        """Seed of the run."""
        return str(self.config.get("seed", ""))


def show_resume(path: Path, modules: Sequence[str] = ()) -> str:
    """Return the command that resumes a run, with modules that the user has named."""
    return show_command("train", f"resume={quote(str(path))}", *show_modules(modules))


def show_modules(modules: Sequence[str]) -> list[str]:
    """Return the argument ``modules=[...]``, if there are any."""
    return [f"modules=[{','.join(modules)}]"] if modules else []


def read_runs(folder: Path) -> list[Run]:
    """Read every run in a folder, begun or not; raise ValueError if there is none.

    Studies that train no policy, such as those of the lateral line, are left out.
    """
    paths = [folder, *sorted(folder.iterdir())] if folder.is_dir() else []
    found = [p for p in paths if RunFolder(p).config.is_file() or RunFolder(p).failure.is_file()]
    if folder in found:
        raise ValueError(
            f"{folder}: is a single run; give the folder that holds it, {folder.absolute().parent}"
        )
    runs = [run for run in map(read_run, found) if not run.config or "total_frames" in run.config]
    if not runs:
        raise ValueError(
            f"{folder}: holds no runs; give the folder of a sweep, such as runs/sweep-<time>"
        )
    return runs


def read_run(path: Path) -> Run:
    """Read one run; raise ValueError if its files are damaged."""
    folder, frames = RunFolder(path), count_frames(path)
    summary = read_summary(folder.summary)
    config = read_config(folder.config) if folder.config.is_file() else {}
    status, reason = "finished" if summary else "stopped", ""
    if is_held(path):
        status = "running"
    elif folder.failure.is_file():
        lines = folder.failure.read_text("utf-8", "replace").strip().splitlines()
        status = "finished" if summary else "failed"
        reason = lines[-1] if lines else "unknown"
    return Run(
        path=path, status=status, reason=reason, frames=frames, config=config, summary=summary
    )


def count_frames(path: Path) -> int:
    """Return the frames in the last whole row of a run's metrics."""
    metrics = RunFolder(path).metrics
    if not metrics.is_file():
        return 0
    rows = read_rows(metrics)
    return int(rows[-1]["frames"]) if rows else 0


def is_held(path: Path) -> bool:
    """Return whether another process writes a run; see ``RunFolder.hold``."""
    path = RunFolder(path).lock
    if not path.is_file():
        return False
    with path.open() as file:
        return not take_lock(file)


def advise(runs: Sequence[Run], *, modules: Sequence[str] = ()) -> str:
    """Report how many runs are finished, what failed in each, and how to resume it.

    ``modules`` are the modules outside fishrl that the user has named.
    """
    finished = sum(run.status == "finished" for run in runs)
    lines = [f"{finished} of {len(runs)} runs finished"]
    for run in runs:
        if run.status == "finished" and not run.reason:
            continue
        because = f" ({run.reason})" if run.reason else ""
        lines.append(f"- {run.path.name}: {run.status} at frame {run.frames}{because}")
        if not run.config:
            fix = "fix the setting and " if run.reason else ""
            lines.append(f"  {fix}repeat the command of the sweep")
        elif run.status != "running":
            lines.append(f"  rerun: {show_resume(run.path, modules)}")
    return "\n".join(lines)
