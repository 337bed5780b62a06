"""A sweep in tables: Markdown to read, CSV to go on with."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from experiments.statistics import Statistic
from experiments.sweeps.groups import Group, number_names
from experiments.sweeps.runs import Run

#: Of every group: heading, entry of summary.json, format.
COLUMNS = (
    ("success", "success_rate", ".1%"),
    ("return", "mean_return", ".2f"),
    ("duration, T", "mean_length_T", ".1f"),
    ("minutes", "wall_seconds", ".1f"),
)


def write_table(groups: Sequence[Group]) -> str:
    """Return a Markdown table: a row per group, each number as mean ± 95 % CI and IQM."""
    keys = list(groups[0].settings)
    heads = [*(f"`{key}`" for key in keys), "seeds"]
    for head, name, _ in COLUMNS:
        heads += [head] if name == "wall_seconds" else [f"{head}: mean ± 95 % CI", "IQM"]
    lines = [_row(heads), "|---" * len(heads) + "|"]
    for group in groups:
        finished, begun = len(group.finished), len(group.seeds)
        count = str(finished) if finished == begun else f"{finished}/{begun}"
        cells = [*group.settings.values(), count]
        for _, name, form in COLUMNS:
            found = Statistic.of(group.numbers(name))
            if name == "wall_seconds":
                cells.append(_show(found.mean / 60.0, form))
                continue
            mean, half = _show(found.mean, form), _show(found.half_width, form)
            cells += [mean if half == "–" else f"{mean} ± {half}", _show(found.iqm, form)]
        lines.append(_row(cells))
    return "\n".join(lines) + "\n"


def write_statistics(groups: Sequence[Group], path: Path) -> None:
    """Write a CSV file with a row per group and number of its summaries."""
    keys = list(groups[0].settings)
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow([*keys, "metric", "seeds", "mean", "ci95_low", "ci95_high", "iqm"])
        for group in groups:
            for name in number_names(groups):
                found = Statistic.of(group.numbers(name))
                ends = (found.mean - found.half_width, found.mean + found.half_width)
                numbers = [found.mean, *ends, found.iqm]
                cells = [*group.settings.values(), name, found.count]
                writer.writerow([*cells, *("" if x != x else f"{x:.10g}" for x in numbers)])


def write_runs(groups: Sequence[Group], path: Path) -> None:
    """Write a CSV file with a row per run: what it is, how it fared, and its summary."""
    keys, names = list(groups[0].settings), number_names(groups)
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["run", *keys, "seed", "status", "reason", *names])
        for group in groups:
            for run in group.runs:
                told = [run.path.name, *group.settings.values(), *_fate(run)]
                writer.writerow([*told, *(_blank(run.summary.get(name)) for name in names)])


def _fate(run: Run) -> list[str]:
    return [str(run.config.get("seed", "")), run.status, run.reason]


def _blank(value: Any) -> Any:
    return "" if value is None else value


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _show(value: float, form: str) -> str:
    return "–" if value != value else format(value, form)
