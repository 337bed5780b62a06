"""Write the generated parts of docs/karman_gait.md: ``python -m experiments.gait_page``."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from shutil import copyfile
from typing import Any

from experiments.gait import pictures, tables
from experiments.gait.snapshots import write_period
from experiments.gait.trials import list_shedding, load_trial
from experiments.pages import fill, write_table
from experiments.program import program

FIGURES = ("survival", "paths", "places", "decisions", "lean", "work")


@dataclass(kw_only=True)
class GaitPageSettings:
    """Settings of the page; parts without a folder are left unchanged.

    Args:
        docs: folder of the documentation.
        design: folders of ``experiments.transfer`` with baseline pid, by the name of their task.
        fixed: folder of ``experiments.transfer`` with baselines of one frequency.
        drift: folder of ``experiments.drift_sweep``.
        line: run folder of ``experiments.train_lateral_line``.
        transfer: folder of ``experiments.transfer``.
        runs: run folders of ``transfer``.
        beside: folder of another transfer test, whose policies are appended to the tables.
        free_stream: folder of ``experiments.free_stream``; it needs ``transfer``.
        arm: policy whose work is compared.
    """

    docs: str = "docs"
    design: dict[str, str] = field(default_factory=dict)
    fixed: str | None = None
    drift: str | None = None
    line: str | None = None
    transfer: str | None = None
    runs: tuple[str, ...] = ()
    beside: str | None = None
    free_stream: str | None = None
    arm: str = "both modules"

    def __post_init__(self) -> None:
        """Check that the parts of the transfer test come together."""
        if (self.transfer is None) == bool(self.runs):
            raise ValueError(f"runs = {list(self.runs)}: give them with transfer, and only then")
        if self.free_stream is not None and self.transfer is None:
            raise ValueError(f"free_stream = {self.free_stream}: give transfer too")


def read(folder: str, name: str) -> dict[str, Any]:
    """Return the results in a folder."""
    results: dict[str, Any] = json.loads((Path(folder) / name).read_text(encoding="utf-8"))
    return results


def write_transfer(
    page: Path, figures: Path, folder: str, runs: Sequence[str], beside: str | None = None
) -> None:
    """Write tables and figures of a transfer test and of its trainings."""
    results = read(folder, "transfer.json")
    others = read(beside, "transfer.json")["arms"] if beside is not None else {}
    fill(page, "transfer", tables.write_results(results["arms"] | others, results["speeds_bl"]))
    for name in FIGURES:
        copyfile(Path(folder) / f"{name}.png", figures / f"{name}.png")
    trials = {Path(run): load_trial(Path(run)) for run in runs}
    by_arm: dict[str, list[Path]] = {}
    for run, trial in trials.items():
        by_arm.setdefault(trial.arm, []).append(run)
    pictures.write_training(figures / "training.png", by_arm)
    chosen = [trial for trial in trials.values() if trial.arm == "both modules"]
    shown = (chosen or list(trials.values()))[0]
    periods_T = [1.0 / frequency for frequency in list_shedding(shown.task)]
    write_period(figures / "period.png", shown, num_decisions=8, periods_T=periods_T)


def write_design(page: Path, folders: Mapping[str, str]) -> None:
    """Write the survival of the PID controller in tasks of several designs."""
    results = {name: read(folder, "transfer.json") for name, folder in folders.items()}
    rows = {name: result["arms"]["pid"] for name, result in results.items()}
    speeds = next(iter(results.values()))["speeds_bl"]
    fill(page, "design", tables.write_survival_table("task", rows, speeds))


def write_fixed(page: Path, folder: str) -> None:
    """Write the survival of baselines of one frequency."""
    results = read(folder, "transfer.json")
    text = tables.write_survival_table("policy", results["arms"], results["speeds_bl"])
    fill(page, "fixed", text)


def write_free_stream(page: Path, figures: Path, folder: str, wake: str, arm: str) -> None:
    """Write the comparison of work with a transfer test."""
    free, results = read(folder, "free_stream.json"), read(wake, "transfer.json")
    rows = [
        [
            f"{speed:g}",
            f"{row['frequency']:.2f}",
            f"{row['drift']:+.4f}",
            f"{row['lean']:.1f}",
            f"{row['held']:.0f} of {row['episodes']:.0f}",
        ]
        for speed, row in zip(free["speeds_bl"], free["flows"], strict=True)
    ]
    held = write_table(("stream, L/T", "beats per T", "drift, L/T", "lean, °", "held"), rows)
    work = tables.write_work_table(results["arms"][arm], free["flows"], free["speeds_bl"])
    note = f"Free stream: T = {free['steps_per_T']} steps, Mach {free['mach']:.2f}."
    fill(page, "work", f"{held}\n{work}\n{note}")
    pictures.write_work(
        figures / "work.png", results["work"][arm], free["work"], speeds=free["speeds_bl"]
    )


def write_lateral_line(page: Path, figures: Path, folder: str) -> None:
    """Write a study of the lateral line, its headings one level deeper."""
    text = (Path(folder) / "lateral_line.md").read_text(encoding="utf-8")
    body = text.split("\n", 1)[1].replace("\n## ", "\n### ")
    for picture in sorted(Path(folder).glob("*.png")):
        name = f"line_{picture.name}"
        copyfile(picture, figures / name)
        body = body.replace(f"]({picture.name})", f"](figures/gait/{name})")
    fill(page, "lateral line", body)


def write_drift(page: Path, figures: Path, folder: str) -> None:
    """Write the drift sweep."""
    facts = read(folder, "drift.json")
    shedding = ", ".join(f"{value:.3f}" for value in facts["shedding_frequencies_per_T"])
    copyfile(Path(folder) / "drift.png", figures / "drift.png")
    text = (
        f"L = {facts['body_length']}, Re_f = {facts['reynolds']:g}, {facts['steps_per_T']} steps "
        f"per T, τ = {facts['tau']:.4f}, Mach {facts['mach']:.2f}; {facts['episodes']} episodes, "
        f"{facts['diverged']} diverged. Shedding frequencies: {shedding} per T.\n\n"
        "![Drift against tail beat](figures/gait/drift.png)"
    )
    fill(page, "drift", text)


@program(GaitPageSettings)
def main(settings: GaitPageSettings) -> None:
    """Write the parts that are given."""
    docs = Path(settings.docs)
    page, figures = docs / "karman_gait.md", docs / "figures" / "gait"
    figures.mkdir(parents=True, exist_ok=True)
    if settings.design:
        write_design(page, settings.design)
    if settings.fixed is not None:
        write_fixed(page, settings.fixed)
    if settings.drift is not None:
        write_drift(page, figures, settings.drift)
    if settings.line is not None:
        write_lateral_line(page, figures, settings.line)
    if settings.transfer is not None:
        write_transfer(page, figures, settings.transfer, settings.runs, settings.beside)
        if settings.free_stream is not None:
            write_free_stream(page, figures, settings.free_stream, settings.transfer, settings.arm)
    print(f"written: {page}, {figures}")


if __name__ == "__main__":
    main()
