"""What may change when a run continues, and what fixes its result."""

from dataclasses import replace
from typing import Any, TypeVar

from fishrl.settings import Role, flatten, list_fields, to_plain
from fishrl.training.classifier import name_recognition
from fishrl.training.plan import FIXED, Plan
from fishrl.training.run_folder import RunFolder, read_config, read_summary

P = TypeVar("P", bound=Plan)


def find_run(plan: Plan) -> RunFolder | None:
    """Return the folder that a plan names if it holds a run."""
    folder = None if plan.path is None else RunFolder(plan.path)
    return folder if folder is not None and folder.config.is_file() else None


def continue_as(folder: RunFolder, plan: P) -> P:
    """Return a plan as the run in a folder continues with it: with its own logger, folder and name.

    Raises:
        ValueError: naming each setting that fixes the result and differs from the run's.
    """
    stored = type(plan).from_config(read_config(folder.config))
    plan = replace(
        plan,
        recognition=name_recognition(plan.recognition, folder.path),
        logger=stored.logger,
        folder=stored.folder,
        name=stored.name,
    )
    flat, other = (
        flatten({name: to_plain(getattr(each, name)) for name in FIXED}) for each in (stored, plan)
    )
    different = [key for key in {**other, **flat} if flat.get(key) != other.get(key)]
    if different:
        lines = [
            f"{key} = {other.get(key)}: is {flat.get(key)} in {folder.path}" for key in different
        ]
        raise ValueError("\n".join(lines) + "; take another folder or name for a new run")
    return plan


def read_result(folder: RunFolder, plan: Plan) -> dict[str, Any] | None:
    """Return the summary of a run that is finished, also with the settings of a plan, or None.

    More frames or another final evaluation make it unfinished.
    """
    if not folder.summary.is_file() or folder.failure.is_file():
        return None
    summary, stored = (
        read_summary(folder.summary),
        type(plan).from_config(read_config(folder.config)),
    )
    late = [entry.name for entry in list_fields(type(plan)) if entry.role is Role.EVALUATION]
    is_same = all(getattr(plan, name) == getattr(stored, name) for name in late)
    return summary if is_same and plan.total_frames <= summary.get("frames", 0) else None


def find_result(plan: Plan) -> dict[str, Any] | None:
    """Return the summary of the run that a plan names, see ``read_result``, or None.

    Raises:
        ValueError: see ``continue_as``.
    """
    folder = find_run(plan)
    return None if folder is None else read_result(folder, continue_as(folder, plan))
