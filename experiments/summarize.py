"""Turn a sweep folder into tables and curves: ``python -m experiments.summarize runs/sweep-...``.

Runs that differ only in their seed are put together. Written into the folder: ``summary.md`` (mean,
95 % confidence interval, interquartile mean, and what is to be rerun), ``summary.csv`` (the same
for every number of the summaries), ``runs.csv`` (each run) and ``curves.png``.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from experiments.program import program
from experiments.sweeps.runs import advise, read_runs


def summarize(folder: Path) -> str:
    """Write tables and curves of a sweep into its folder.

    Args:
        folder: that holds the run folders.

    Returns:
        The text of ``summary.md``.

    Raises:
        ValueError: if there are no runs, or none that began.
    """
    from experiments.sweeps.curves import write_curves
    from experiments.sweeps.groups import group_runs
    from experiments.sweeps.tables import write_runs, write_statistics, write_table

    runs = read_runs(folder)
    groups = group_runs(runs)
    if not groups:
        raise ValueError(f"{folder}: no run has begun\n{advise(runs)}")
    text = f"# {folder.resolve().name}\n\n{write_table(groups)}\n{advise(runs)}\n"
    (folder / "summary.md").write_text(text, encoding="utf-8")
    write_statistics(groups, folder / "summary.csv")
    write_runs(groups, folder / "runs.csv")
    if write_curves(groups, folder / "curves.png"):
        text += f"\ncurves: {folder / 'curves.png'}\n"
    return text


@dataclass(kw_only=True)
class SummarizeSettings:
    """Settings of a summary.

    Args:
        folder: of a sweep, which holds the run folders.
    """

    folder: str


@program(SummarizeSettings, positional="folder")
def main(settings: SummarizeSettings) -> None:
    """Print the table."""
    print(summarize(Path(settings.folder)))


if __name__ == "__main__":
    main()
