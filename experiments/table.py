"""Put finished runs side by side: ``python -m experiments.table runs/a runs/b``.

Prints a Markdown table of the runs' ``summary.json``: the learned fish, then the hand-written ones
from the same starts. ``--docs docs`` puts it into docs/results.md, with the first run's pictures.
"""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from shutil import copyfile
from typing import Any

from experiments.pages import fill
from experiments.statistics import half_width

FISH = ("", "intercept_", "pursuit_", "random_")
HEADER = (
    "| run | learned | intercept | pursuit | random | return | time to success | frames | diverged "
    "| minutes | MLUPS |"
)
PICTURES = ("learning_curve.png", "trajectories.png", "vorticity_sequence.png", "capture.gif")


def read_summary(folder: Path) -> dict[str, Any]:
    """Read a run's summary.

    Raises:
        ValueError: if the run has none.
    """
    path = folder / "summary.json"
    if not path.is_file():
        raise ValueError(f"{folder} has no summary.json: give run folders of finished runs")
    return dict(json.loads(path.read_text()))


def make_row(name: str, summary: dict[str, Any]) -> str:
    """Write one run as a row: rates of success first."""
    rates = [
        f"{summary[f'{fish}success_rate']:.1%}" if f"{fish}success_rate" in summary else "-"
        for fish in FISH
    ]
    duration = summary["mean_time_to_success_T"]
    cells = [
        name,
        *rates,
        f"{summary['mean_return']:.1f}",
        "-" if duration is None else f"{duration:.1f} T",
        str(summary["frames"]),
        str(summary["train_diverged"]),
        f"{summary['wall_seconds'] / 60:.1f}",
        f"{summary['mlups']:.0f}",
    ]
    return "| " + " | ".join(cells) + " |"


def make_table(folders: Sequence[Path]) -> str:
    """Write a row per run, and below the mean rate of the learned fish.

    Raises:
        ValueError: if a run has no summary.
    """
    summaries = [read_summary(folder) for folder in folders]
    rows = [make_row(folder.name, s) for folder, s in zip(folders, summaries, strict=True)]
    lines = [HEADER, "|---" * (HEADER.count("|") - 1) + "|", *rows]
    if len(rows) > 1:
        rates = [100.0 * summary["success_rate"] for summary in summaries]
        mean, half = sum(rates) / len(rates), half_width(rates)
        lines += [
            "",
            f"Learned, over {len(rows)} seeds: {mean:.0f} ± {half:.0f} % (95 % interval).",
        ]
    return "\n".join(lines) + "\n"


def write_page(text: str, run: Path, docs: Path) -> None:
    """Put the table into docs/results.md, and a run's pictures beside it.

    Raises:
        ValueError: if the page has no place for the table, or the run has no pictures.
    """
    missing = [name for name in PICTURES if not (run / name).is_file()]
    if missing:
        raise ValueError(f"{run} has no {', '.join(missing)}: give runs with picture_episodes > 0")
    fill(docs / "results.md", "predation", text)
    for name in PICTURES:
        copyfile(run / name, docs / "figures" / name)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="Put finished runs side by side.")
    parser.add_argument("folders", type=Path, nargs="+", help="run folders")
    parser.add_argument("--docs", type=Path, help="folder of the pages to put table and pictures")
    options = parser.parse_args()
    try:
        text = make_table(options.folders)
        if options.docs is not None:
            write_page(text, options.folders[0], options.docs)
    except ValueError as error:
        parser.error(str(error))
    print(text, end="")


if __name__ == "__main__":
    main()
