"""Put finished runs side by side: ``python -m experiments.table runs/a runs/b``.

Prints a Markdown table of the runs' ``summary.json``: the learned fish, then the hand-written ones
from the same starts.
"""

import argparse
import json
from pathlib import Path
from typing import Any

FISH = ("", "intercept_", "pursuit_", "random_")
HEADER = (
    "| run | learned | intercept | pursuit | random | return | time to success | frames | diverged "
    "| minutes | MLUPS |"
)


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


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="Put finished runs side by side.")
    parser.add_argument("folders", type=Path, nargs="+", help="run folders")
    folders = parser.parse_args().folders
    try:
        rows = [make_row(folder.name, read_summary(folder)) for folder in folders]
    except ValueError as error:
        parser.error(str(error))
    print(HEADER)
    print("|---" * (HEADER.count("|") - 1) + "|")
    print("\n".join(rows))


if __name__ == "__main__":
    main()
