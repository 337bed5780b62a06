"""Tables of a sweep, in Markdown and CSV."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

from experiments.pages import write_table
from experiments.statistics import Statistic
from experiments.sweeps.groups import Group, number_names

#: Heading, entry of a run's summary, format.
COLUMNS = (
    ("success", "success_rate", ".1%"),
    ("return", "mean_return", ".2f"),
    ("learning curve", "curve_mean", ".3f"),
    ("duration, T", "mean_length_T", ".1f"),
)
#: What groups are compared by, seed by seed.
COMPARED = COLUMNS[:3]


def write_groups(groups: Sequence[Group]) -> str:
    """Return a Markdown table with a row per group: mean ± 95 % interval, and interquartile mean.

    ``learning curve`` is the mean success rate over all evaluations of a training: the earlier a
    policy succeeds, the greater.
    """
    heads = [*(f"`{key}`" for key in groups[0].settings), "seeds"]
    for head, _, _ in COLUMNS:
        heads += [f"{head}: mean ± 95 % CI", "IQM"]
    rows = []
    for group in groups:
        finished, begun = len(group.finished), len(group.seeds)
        count = str(finished) if finished == begun else f"{finished}/{begun}"
        row = [*group.settings.values(), count]
        for _, name, form in COLUMNS:
            found = Statistic.of(group.numbers(name))
            row += [found.show(form), "–" if found.iqm != found.iqm else format(found.iqm, form)]
        rows.append([*row, _minutes(group)])
    return write_table([*heads, "minutes"], rows)


def _minutes(group: Group) -> str:
    return Statistic.of([seconds / 60.0 for seconds in group.numbers("wall_seconds")]).show(".0f")


def write_differences(groups: Sequence[Group]) -> str:
    """Return a Markdown table of the first group minus each other one, paired by seed."""
    first, *others = groups
    rows = []
    for group in others:
        row = [group.label]
        for _, name, form in COMPARED:
            ours, theirs = first.by_seed(name), group.by_seed(name)
            both = [ours[seed] - theirs[seed] for seed in ours if seed in theirs]
            found = Statistic.of(both)
            is_clear = abs(found.mean) > found.half_width
            row.append(f"**{found.show(form)}**" if is_clear else found.show(form))
        rows.append(row)
    return write_table([f"{first.label} minus", *(head for head, _, _ in COMPARED)], rows)


def describe_effort(groups: Sequence[Group]) -> str:
    """Say whether the finished runs had equally many frames and gradient steps."""
    runs = [run.summary for group in groups for run in group.finished]
    efforts = sorted({(run.get("frames", 0), run.get("updates", 0)) for run in runs})
    if len(efforts) == 1:
        return "{} frames and {} gradient steps each.".format(*efforts[0])
    return f"Efforts differ, (frames, gradient steps): {efforts}."


def write_each(groups: Sequence[Group]) -> str:
    """Return a Markdown table with a row per finished run, its baselines beside it."""
    runs = [run for group in groups for run in group.finished]
    names = list(dict.fromkeys(name for run in runs for name in run.summary.get("baselines", ())))
    rows = []
    for run in runs:
        keys = ["success_rate", *(f"{name}_success_rate" for name in names)]
        rates = [run.summary.get(key) for key in keys]
        row = [run.path.name, *("–" if rate is None else f"{rate:.1%}" for rate in rates)]
        for key, form in (
            ("mean_return", ".1f"),
            ("mean_time_to_success_T", ".1f"),
            ("frames", "d"),
            ("train_diverged", "d"),
            ("mlups", ".0f"),
        ):
            value = run.summary.get(key)
            row.append("–" if value is None else format(value, form))
        rows.append(row)
    heads = ["run", "learned", *names, "return", "time to success, T", "frames", "diverged"]
    return write_table([*heads, "MLUPS"], rows)


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
    """Write a CSV file with a row per run: its settings, status and summary."""
    keys, names = list(groups[0].settings), number_names(groups)
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["run", *keys, "seed", "status", "reason", *names])
        for group in groups:
            for run in group.runs:
                row = [run.path.name, *group.settings.values(), run.config.get("seed", "")]
                row += [run.status, run.reason, *(run.summary.get(name) for name in names)]
                writer.writerow(row)
