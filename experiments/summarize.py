"""Write tables and curves of a sweep: ``python -m experiments.summarize runs/sweep-...``.

Runs that differ only in their seed form a group. Written into the folder: ``summary.md`` (mean,
95 % confidence interval and interquartile mean of each group, differences between groups paired by
seed, each run beside its baselines, and runs to repeat), ``summary.csv`` (the same for every
number of the summaries), ``runs.csv`` (each run) and ``curves.png``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from shutil import copyfile

from experiments.figures import read_metrics
from experiments.pages import fill
from experiments.program import program
from experiments.sweeps.curves import write_curves
from experiments.sweeps.groups import group_runs
from experiments.sweeps.runs import Run, advise, read_runs
from experiments.sweeps.tables import (
    describe_effort,
    write_differences,
    write_each,
    write_groups,
    write_runs,
    write_statistics,
)


@dataclass(kw_only=True)
class SummarizeSettings:
    """Settings of a summary.

    Args:
        folder: of a sweep, which holds the run folders.
        page: Markdown file to write the tables into, between the marks ``summary``. Pictures go to
            ``figures`` beside it: the curves under the name of the page, and those pictures of the
            first run that the page shows.
    """

    folder: str
    page: str | None = None


def summarize(folder: Path, *, page: Path | None = None) -> str:
    """Write tables and curves of a sweep into its folder.

    Args:
        folder: that holds the run folders.
        page: see ``SummarizeSettings``.

    Returns:
        The text of ``summary.md``.

    Raises:
        ValueError: if there are no runs, or none that began.
    """
    runs = [add_curve_mean(run) for run in read_runs(folder)]
    groups = group_runs(runs)
    if not groups:
        raise ValueError(f"{folder}: no run has begun\n{advise(runs)}")
    tables = [write_groups(groups)]
    if any(group.finished for group in groups):
        tables.append(f"{describe_effort(groups)}\n")
        if len(groups) > 1:
            tables.append(write_differences(groups))
        tables.append(write_each(groups))
    text = "\n".join(tables)
    write_statistics(groups, folder / "summary.csv")
    write_runs(groups, folder / "runs.csv")
    has_curves = write_curves(groups, folder / "curves.png")
    if page is not None:
        fill(page, "summary", text)
        figures, shown = page.parent / "figures", page.read_text(encoding="utf-8")
        if has_curves:
            copyfile(folder / "curves.png", figures / f"{page.stem}.png")
        for picture in sorted(runs[0].path.iterdir()):
            if f"figures/{picture.name}" in shown:
                copyfile(picture, figures / picture.name)
    text = f"# {folder.resolve().name}\n\n{text}\n{advise(runs)}\n"
    (folder / "summary.md").write_text(text, encoding="utf-8")
    return text + (f"\ncurves: {folder / 'curves.png'}\n" if has_curves else "")


def add_curve_mean(run: Run) -> Run:
    """Add the mean success rate over all evaluations of a training to the summary of a run."""
    if not run.summary or not run.frames:
        return run
    _, rates = read_metrics(run.path / "metrics.csv")["eval/success_rate"]
    return replace(run, summary={**run.summary, "curve_mean": float(rates.mean())})


@program(SummarizeSettings, positional="folder")
def main(settings: SummarizeSettings) -> None:
    """Print the tables."""
    page = None if settings.page is None else Path(settings.page)
    print(summarize(Path(settings.folder), page=page))


if __name__ == "__main__":
    main()
