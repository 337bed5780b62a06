"""Groups of runs that differ only in their seed and in harmless settings."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fishrl.programs.sweeps.runs import Run
from fishrl.programs.train_settings import TrainConfig
from fishrl.settings import TARGET, Role, find_role, flatten
from fishrl.training.recognition import name_content

#: Settings that imply several others, and so distinguish groups first.
_FIRST = ("preset", "task._target_")


@dataclass(frozen=True, kw_only=True)
class Group:
    """Runs with the same settings, finished or not."""

    settings: dict[str, str]  #: those in which the groups of a sweep differ, as words
    runs: list[Run]  #: all of them

    @property
    def label(self) -> str:
        """Settings in one line."""
        known = {key: value for key, value in self.settings.items() if value != "–"}
        words = (v if k.endswith("_target_") else f"{k} {v}" for k, v in known.items())
        return ", ".join(words) or "all"

    @property
    def seeds(self) -> list[Run]:
        """One run per seed, the one with the most frames; repetitions add no information."""
        best: dict[str, Run] = {}
        for run in self.runs:
            known = best.setdefault(run.seed, run)
            if (run.status == "finished", run.frames) > (known.status == "finished", known.frames):
                best[run.seed] = run
        return list(best.values())

    @property
    def finished(self) -> list[Run]:
        """Finished runs, one per seed."""
        return [run for run in self.seeds if run.status == "finished"]

    def by_seed(self, name: str) -> dict[str, float]:
        """Return a numeric entry of the summaries by seed."""
        entries: dict[str, Any] = {run.seed: run.summary.get(name) for run in self.finished}
        return {seed: float(value) for seed, value in entries.items() if is_number(value)}

    def numbers(self, name: str) -> list[float]:
        """Return the values of ``by_seed``."""
        return list(self.by_seed(name).values())


def group_runs(runs: Sequence[Run]) -> list[Group]:
    """Group runs that differ only in seed and harmless settings, in order of appearance.

    Each group is labelled by the fewest settings that distinguish all groups; those that follow
    from others, such as what a preset sets, are left out. So are runs that never began.
    """
    begun = [run for run in runs if run.config]
    flat = [_settings_of(run) for run in begun]
    keys = _find_distinguishing(flat)
    groups: dict[tuple[str, ...], Group] = {}
    for run, settings in zip(begun, flat, strict=True):
        label = {key: settings.get(key, "–") for key in keys}
        groups.setdefault(tuple(label.values()), Group(settings=label, runs=[])).runs.append(run)
    return list(groups.values())


def is_number(value: Any) -> bool:
    """Return whether an entry of a summary is a finite number."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _find_distinguishing(flat: Sequence[Mapping[str, str]]) -> list[str]:
    """List the fewest settings that separate all groups."""

    def count(keys: Sequence[str]) -> int:
        return len({tuple(settings.get(key, "–") for key in keys) for settings in flat})

    kept: list[str] = []
    for name in dict.fromkeys([*_FIRST, *(name for settings in flat for name in settings)]):
        if count([*kept, name]) > count(kept):
            kept.append(name)
    for name in list(kept):
        others = [key for key in kept if key != name]
        if count(others) == count(kept):
            kept = others
    return kept


def _settings_of(run: Run) -> dict[str, str]:
    """Return the settings of a run; a classifier is identified by its content."""
    flat = {
        key: str(value).rpartition(".")[2] if key.endswith(TARGET) else str(value)
        for key, value in flatten(run.config).items()
        if key != "seed" and find_role(TrainConfig, key) in (Role.RESULT, Role.CONTINUATION)
    }
    if "recognition.path" in flat:
        flat["recognition.path"] = name_content(Path(flat["recognition.path"]))
    return flat
