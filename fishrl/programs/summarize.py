"""Write tables and curves of a sweep: ``fishrl summarize runs/sweep-...``.

Runs that differ only in their seed form a group. Written into the folder: ``summary.md`` (mean
and interquartile mean of each group with 95 % intervals, differences between groups paired by seed
and probability of improvement, each run next to its baselines, and runs to repeat),
``summary.csv`` (every number of the summaries), ``runs.csv`` (each run) and ``curves.png``.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fishrl.files import claim, write_whole
from fishrl.pages import write_csv, write_table
from fishrl.programs.figures.learning_curve import RATE, Curve, draw_curves, read_metrics
from fishrl.programs.program import program
from fishrl.programs.statistics import (
    find_improvement,
    find_interquartile_mean,
    find_mean,
    half_width,
)
from fishrl.programs.sweeps.groups import Group, group_runs, is_number
from fishrl.programs.sweeps.runs import Run, advise, read_run, read_runs

#: Heading, entry of a run's summary, format. ``curve_mean`` is the mean success rate over all
#: evaluations of a training: the earlier a policy succeeds, the greater.
COLUMNS = (
    ("success", "success_rate", ".1%"),
    ("return", "mean_return", ".2f"),
    ("learning curve", "curve_mean", ".3f"),
    ("duration, T", "mean_length_T", ".1f"),
)
#: Columns by which groups are compared, seed by seed.
COMPARED = COLUMNS[:3]
#: Columns of each run, after the success rates of policy and baselines.
EACH = (
    ("return", "mean_return", ".1f"),
    ("time to success, T", "mean_time_to_success_T", ".1f"),
    ("frames", "frames", "d"),
    ("diverged", "train_diverged", "d"),
    ("MLUPS", "mlups", ".0f"),
)
#: Panels of the figure, and their columns of metrics.csv.
PANELS = {
    RATE: "eval/success_rate",
    "return per episode": "eval/mean_return",
    "return while learning": "train/return",
}


def summarize(folder: Path, *, paths: Sequence[Path] | None = None) -> str:
    """Write tables and curves of a sweep into its folder, and return the text of summary.md.

    ``paths`` are the runs; by default all in the folder.
    """
    found = read_runs(folder) if paths is None else map(read_run, paths)
    with claim(folder / "summary.md"):
        return _summarize(folder, found)


def _summarize(folder: Path, found: Iterable[Run]) -> str:
    runs = [add_curve_mean(run) for run in found]
    groups = group_runs(runs)
    if not groups:
        raise ValueError(f"{folder}: no run has begun\n{advise(runs)}")
    finished = [run for group in groups for run in group.finished]
    tables = [tabulate_groups(groups)]
    if finished:
        tables.append(describe_effort(finished))
        tables += [tabulate_differences(groups)] if len(groups) > 1 else []
        tables.append(tabulate_runs(finished))
    text = "\n".join(tables)
    write_csv_files(groups, folder)
    panels = {
        title: [average(group, column, i) for i, group in enumerate(groups)]
        for title, column in PANELS.items()
    }
    has_curves = draw_curves(folder / "curves.png", panels)
    text = f"# {folder.resolve().name}\n\n{text}\n```\n{advise(runs)}\n```\n"
    write_whole(folder / "summary.md", text)
    return text + (f"\ncurves: {folder / 'curves.png'}\n" if has_curves else "")


def add_curve_mean(run: Run) -> Run:
    """Add ``curve_mean``, the mean success rate of the evaluations, to a run's summary."""
    if not run.summary or not run.frames:
        return run
    metrics = read_metrics(run.path / "metrics.csv")
    _, rates = metrics.get("eval/success_rate", (None, np.empty(0)))
    added = {"curve_mean": float(rates.mean())} if rates.size else {}
    return replace(run, summary=run.summary | added)


def average(group: Group, column: str, number: int = 0) -> Curve:
    """Return the mean of a column over the seeds of a group, with its 95 % interval.

    At each frame that any run has logged, the runs count that have begun and come so far, linearly
    interpolated.
    """
    begun = [read_metrics(run.path / "metrics.csv") for run in group.seeds if run.frames > 0]
    series = [metrics[column] for metrics in begun if column in metrics and metrics[column][0].size]
    frames = np.unique(np.concatenate([x for x, _ in series])) if series else np.empty(0)
    mean, half = np.empty_like(frames), np.empty_like(frames)
    for i, frame in enumerate(frames):
        values = [float(np.interp(frame, x, y)) for x, y in series if x[0] <= frame <= x[-1]]
        mean[i], half[i] = np.mean(values), half_width(values)
    return Curve(group.label, frames, mean, half, number)


def tabulate_groups(groups: Sequence[Group]) -> str:
    """Return a row per group: means and interquartile means, with 95 % intervals."""
    heads = [*(f"`{key.removesuffix('._target_')}`" for key in groups[0].settings), "seeds"]
    for head, _, _ in COLUMNS:
        heads += [f"{head}: mean", "IQM"]
    rows = []
    for group in groups:
        finished, begun = len(group.finished), len(group.seeds)
        row = [*group.settings.values(), f"{finished}/{begun}" if finished < begun else f"{begun}"]
        for _, name, form in COLUMNS:
            values = group.numbers(name)
            row += [find_mean(values).show(form), find_interquartile_mean(values).show(form)]
        minutes = find_mean([seconds / 60.0 for seconds in group.numbers("wall_seconds")])
        rows.append([*row, minutes.show(".1f")])
    return write_table([*heads, "minutes"], rows)


def tabulate_differences(groups: Sequence[Group]) -> str:
    """Return differences from the first group, paired by seed; significant ones in bold.

    The last column is the probability that the first one's learning curve has the greater mean.
    """
    first, *others = groups
    rows = []
    for group in others:
        row = [group.label]
        for _, name, form in COMPARED:
            ours, theirs = first.by_seed(name), group.by_seed(name)
            found = find_mean([ours[seed] - theirs[seed] for seed in ours if seed in theirs])
            is_clear = found.low > 0.0 or found.high < 0.0
            row.append(f"**{found.show(form)}**" if is_clear else found.show(form))
        curves = (group.numbers("curve_mean") for group in (first, group))
        rows.append([*row, find_improvement(*curves).show(".2f")])
    heads = [f"{first.label} minus", *(head for head, _, _ in COMPARED)]
    return write_table([*heads, "probability of improvement"], rows)


def describe_effort(finished: Sequence[Run]) -> str:
    """Return a sentence about frames and gradient steps, which may differ between runs."""
    efforts = {(run.summary.get("frames", 0), run.summary.get("updates", 0)) for run in finished}
    if len(efforts) == 1:
        return "{} frames and {} gradient steps each.\n".format(*efforts.pop())
    return f"Efforts differ, (frames, gradient steps): {sorted(efforts)}.\n"


def tabulate_runs(finished: Sequence[Run]) -> str:
    """Return a row per run with its baselines."""
    names = dict.fromkeys(name for run in finished for name in run.summary.get("baselines", ()))
    columns = [("learned", "success_rate", ".1%")]
    columns += [(name, f"{name}_success_rate", ".1%") for name in names]
    columns += EACH
    rows = []
    for run in finished:
        values = [(run.summary.get(key), form) for _, key, form in columns]
        cells = ("–" if value is None else format(value, form) for value, form in values)
        rows.append([run.path.name, *cells])
    return write_table(["run", *(head for head, _, _ in columns)], rows)


def write_csv_files(groups: Sequence[Group], folder: Path) -> None:
    """Write ``summary.csv``, a row per group and number, and ``runs.csv``, a row per run."""
    finished = [run.summary for group in groups for run in group.finished]
    entries = [name for summary in finished for name in summary if is_number(summary[name])]
    names = [name for name in dict.fromkeys(entries) if name != "seed"]
    keys = list(groups[0].settings)
    rows: list[list[Any]] = []
    for group in groups:
        for name in names:
            values = group.numbers(name)
            found, iqm = find_mean(values), find_interquartile_mean(values).value
            results = (found.value, found.low, found.high, iqm)
            numbers = ("" if math.isnan(x) else f"{x:.10g}" for x in results)
            rows.append([*group.settings.values(), name, len(values), *numbers])
    heads = [*keys, "metric", "seeds", "mean", "ci95_low", "ci95_high", "iqm"]
    write_csv(folder / "summary.csv", heads, rows)
    rows = []
    for group in groups:
        for run in group.runs:
            row: list[Any] = [run.path.name, *group.settings.values(), run.seed]
            row += [run.status, run.reason, *(run.summary.get(name) for name in names)]
            rows.append(row)
    write_csv(folder / "runs.csv", ["run", *keys, "seed", "status", "reason", *names], rows)


@program(positional="folder")
def main(*, folder: str) -> None:
    """Print the tables.

    Args:
        folder: folder of a sweep, which holds the run folders.
    """
    print(summarize(Path(folder).expanduser()))
