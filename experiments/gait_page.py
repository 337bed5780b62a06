"""Put what was measured of the Kármán gait into docs/karman_gait.md: ``experiments.gait_page``."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from shutil import copyfile
from typing import Any

from experiments.command_line import plain_errors
from experiments.gait import pictures, tables
from experiments.gait.snapshots import write_period
from experiments.gait.trials import load_trial
from experiments.pages import fill
from experiments.transfer import list_shedding

FIGURES = ("survival", "paths", "places", "decisions", "lean", "work")


def write_transfer(
    page: Path, figures: Path, folder: Path, runs: Sequence[Path], beside: Path | None = None
) -> Mapping[str, Any]:
    """Put tables and figures of a transfer test and of its trainings into the page.

    Args:
        page: that takes the tables.
        figures: folder that takes the figures.
        folder: of the transfer test.
        runs: folders of its fish.
        beside: folder of another test, whose fish stand below in the tables.
    """
    results: dict[str, Any] = json.loads((folder / "transfer.json").read_text(encoding="utf-8"))
    speeds, arms = results["speeds_bl"], dict(results["arms"])
    if beside is not None:
        arms |= json.loads((beside / "transfer.json").read_text(encoding="utf-8"))["arms"]
    fill(
        page, "transfer", tables.write_table(arms, speeds) + "\n" + tables.write_ends(arms, speeds)
    )
    for name in FIGURES:
        copyfile(folder / f"{name}.png", figures / f"{name}.png")
    trials = [load_trial(run) for run in runs]
    by_arm: dict[str, list[Path]] = {}
    for run, trial in zip(runs, trials, strict=True):
        by_arm.setdefault(trial.arm, []).append(run)
    pictures.write_training(figures / "training.png", by_arm)
    shown = next((trial for trial in trials if trial.arm == "both modules"), trials[0])
    write_period(
        figures / "period.png",
        shown,
        num_decisions=8,
        periods_T=[1.0 / frequency for frequency in list_shedding(shown.task)],
    )
    return results


def write_design(page: Path, folders: Mapping[str, Path]) -> None:
    """Put how long the PID fish lasts in tasks of several designs into the page."""
    rows = {}
    for name, folder in folders.items():
        results = json.loads((folder / "transfer.json").read_text(encoding="utf-8"))
        rows[name] = results["arms"]["pid"]
    fill(page, "design", _tabulate_survival("task", rows, results["speeds_bl"]))


def write_fixed(page: Path, folder: Path) -> None:
    """Put how long fish of one rate last into the page."""
    results = json.loads((folder / "transfer.json").read_text(encoding="utf-8"))
    fill(page, "fixed", _tabulate_survival("fish", results["arms"], results["speeds_bl"]))


def _tabulate_survival(
    what: str, rows: Mapping[str, Sequence[Mapping[str, float]]], speeds: Sequence[float]
) -> str:
    """Return a table of survival, a row for each name, a column for each flow."""
    head = "".join(f" {speed:g} L/T |" for speed in speeds)
    lines = [f"| {what} | episodes |{head}", "|---" * (2 + len(speeds)) + "|"]
    for name, flows in rows.items():
        shown = "".join(
            f" {flow['survival_T']:.0f} ± {flow['survival_error_T']:.0f} |" for flow in flows
        )
        lines.append(f"| {name} | {flows[0]['episodes']:.0f} |{shown}")
    return "\n".join(lines)


def write_free_stream(
    page: Path, figures: Path, folder: Path, results: Mapping[str, Any], arm: str
) -> None:
    """Put the comparison of work into the page."""
    free = json.loads((folder / "free_stream.json").read_text(encoding="utf-8"))
    lines = ["| stream, L/T | beats per T | drift, L/T | lean, ° | held |", "|---" * 5 + "|"]
    for speed, row in zip(free["speeds_bl"], free["flows"], strict=True):
        held = f"{row['held']:.0f} of {row['episodes']:.0f}"
        lines.append(
            f"| {speed:g} | {row['frequency']:.2f} | {row['drift']:+.4f} "
            f"| {row['lean']:.1f} | {held} |"
        )
    table = tables.write_work_table(results["arms"][arm], free["flows"], free["speeds_bl"])
    note = f"Free stream: T = {free['steps_per_T']} steps, Mach {free['mach']:.2f}."
    fill(page, "work", "\n".join([*lines, "", table, note]))
    pictures.write_work(
        figures / "work.png", results["work"][arm], free["work"], speeds=free["speeds_bl"]
    )


def write_lateral_line(page: Path, figures: Path, folder: Path) -> None:
    """Put a study of the lateral line into the page, its headings one level deeper."""
    text = (folder / "lateral_line.md").read_text(encoding="utf-8")
    body = text.split("\n", 1)[1].replace("\n## ", "\n### ")
    for picture in sorted(folder.glob("*.png")):
        name = f"line_{picture.name}"
        copyfile(picture, figures / name)
        body = body.replace(f"]({picture.name})", f"](figures/gait/{name})")
    fill(page, "lateral line", body)


def write_drift(page: Path, figures: Path, folder: Path) -> None:
    """Put the drift sweep into the page."""
    facts = json.loads((folder / "drift.json").read_text(encoding="utf-8"))
    shed = ", ".join(f"{value:.3f}" for value in facts["shedding_frequencies_per_T"])
    copyfile(folder / "drift.png", figures / "drift.png")
    fill(
        page,
        "drift",
        f"L = {facts['body_length']}, Re_f = {facts['reynolds']:g}, {facts['steps_per_T']} steps "
        f"per T, τ = {facts['tau']:.4f}, Mach {facts['mach']:.2f}; {facts['episodes']} fish, "
        f"{facts['diverged']} diverged. Shedding frequencies: {shed} per T.\n\n"
        "![Drift against tail beat](figures/gait/drift.png)",
    )


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description="Write the measured parts of karman_gait.md.")
    parser.add_argument("--docs", type=Path, default=Path("docs"))
    parser.add_argument(
        "--design",
        nargs="*",
        default=[],
        metavar="NAME=FOLDER",
        help="folders of experiments.transfer with a pid fish, and what their tasks are called",
    )
    parser.add_argument(
        "--fixed", type=Path, help="folder of experiments.transfer, fish of one rate"
    )
    parser.add_argument("--drift", type=Path, help="folder of experiments.drift_sweep")
    parser.add_argument("--line", type=Path, help="run folder of experiments.train_lateral_line")
    parser.add_argument("--transfer", type=Path, help="folder of experiments.transfer")
    parser.add_argument("--runs", type=Path, nargs="*", default=[], help="its run folders")
    parser.add_argument("--beside", type=Path, help="folder of another transfer test, with pid")
    parser.add_argument("--free-stream", type=Path, help="folder of experiments.free_stream")
    parser.add_argument("--arm", default="both modules", help="whose work is compared")
    arguments = parser.parse_args()
    page, figures = arguments.docs / "karman_gait.md", arguments.docs / "figures" / "gait"
    with plain_errors():
        figures.mkdir(parents=True, exist_ok=True)
        if arguments.design:
            pairs = [entry.rpartition("=") for entry in arguments.design]
            write_design(page, {name: Path(folder) for name, _, folder in pairs})
        if arguments.fixed is not None:
            write_fixed(page, arguments.fixed)
        if arguments.drift is not None:
            write_drift(page, figures, arguments.drift)
        if arguments.line is not None:
            write_lateral_line(page, figures, arguments.line)
        if arguments.transfer is not None:
            if not arguments.runs:
                raise ValueError("--transfer: give the run folders of its fish too, with --runs")
            results = write_transfer(
                page, figures, arguments.transfer, arguments.runs, arguments.beside
            )
            if arguments.free_stream is not None:
                write_free_stream(page, figures, arguments.free_stream, results, arguments.arm)
    print(f"written: {page}, {figures}")


if __name__ == "__main__":
    main()
