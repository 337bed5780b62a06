"""What may change when a run continues, and what fixes its result."""

from pathlib import Path
from typing import Any

from fishrl.settings import Role, flatten, list_fields
from fishrl.training.classifier import Recognition, name_recognition
from fishrl.training.plan import LEARNING, Plan
from fishrl.training.run_folder import RunFolder, read_config, read_summary
from fishrl.training.settings import RunSettings

#: Settings that determine the result of a run, by their roles.
FIXED = (
    *LEARNING,
    *(
        entry.name
        for entry in list_fields(Plan)
        if entry.role is Role.RESULT and entry.name not in ("learning", "run", "extra")
    ),
)
#: Settings of a run that only its final evaluation depends on.
FINAL = [entry.name for entry in list_fields(RunSettings) if entry.role is Role.EVALUATION]


def read_plan(folder: RunFolder) -> Plan:
    """Return the settings of a run; errors are those of ``Plan.from_config``."""
    return Plan.from_config(read_config(folder.config))


def find_changes(
    folder: str | Path,
    plan: Plan,
    *,
    recognition: Recognition = None,
) -> dict[str, Any]:
    """Return the settings of a plan that differ from those of a run, as ``reopen`` takes them.

    The run keeps its logger, folder and name.

    Raises:
        ValueError: naming each setting that fixes the result and differs.
    """
    run = RunFolder.of_existing(folder)
    stored, wanted = read_plan(run).to_config(), plan.to_config()
    wanted["recognition"] = name_recognition(recognition, run.path)
    before, now = ({name: config[name] for name in FIXED} for config in (stored, wanted))
    flat, other = flatten(before), flatten(now)
    different = [key for key in {**other, **flat} if flat.get(key) != other.get(key)]
    if different:
        lines = [f"{key} = {other.get(key)}: is {flat.get(key)} in {run.path}" for key in different]
        raise ValueError("\n".join(lines) + "; take another folder or name for a new run")
    kept = {*FIXED, "logger", "folder", "name"}
    names = [name for name in wanted if name not in kept]
    return {name: wanted[name] for name in names if wanted[name] != stored.get(name)}


def find_summary(folder: str | Path, /, **changes: Any) -> dict[str, Any] | None:
    """Return the summary of a run that is finished, also under some changes, or None.

    More frames or another final evaluation make it unfinished; arguments see ``resume``.
    """
    run = RunFolder.of_existing(folder)
    if not run.summary.is_file() or run.failure.is_file():
        return None
    summary, stored = read_summary(run.summary), read_plan(run)
    plan = stored.change(**changes)
    is_same = plan.extra == stored.extra and all(
        getattr(plan.run, name) == getattr(stored.run, name) for name in FINAL
    )
    return summary if is_same and plan.run.total_frames <= summary.get("frames", 0) else None
