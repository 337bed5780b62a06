"""Write the generated parts of docs/karman_gait.md: ``python -m experiments.gait_page``."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from shutil import copyfile
from typing import Any

from experiments.gait import pictures, tables
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


def read(folder: str, name: str = "transfer.json") -> dict[str, Any]:
    """Return the results in a folder."""
    results: dict[str, Any] = json.loads((Path(folder) / name).read_text(encoding="utf-8"))
    return results


def write_design(folders: Mapping[str, str]) -> str:
    """Return the survival of the PID controller in tasks of several designs."""
    results = {name: read(folder) for name, folder in folders.items()}
    rows = {name: result["arms"]["pid"] for name, result in results.items()}
    speeds = next(iter(results.values()))["speeds_bl"]
    return tables.write_survival_table("task", rows, speeds)


def write_fixed(folder: str) -> str:
    """Return the survival of baselines of one frequency."""
    results = read(folder)
    return tables.write_survival_table("policy", results["arms"], results["speeds_bl"])


def write_drift(folder: str, figures: Path) -> str:
    """Return the settings of a drift sweep, and copy its figure."""
    facts = read(folder, "drift.json")
    shedding = ", ".join(f"{value:.3f}" for value in facts["shedding_frequencies_per_T"])
    copyfile(Path(folder) / "drift.png", figures / "drift.png")
    return (
        f"L = {facts['body_length']}, Re_f = {facts['reynolds']:g}, {facts['steps_per_T']} steps "
        f"per T, τ = {facts['tau']:.4f}, Mach {facts['mach']:.2f}; {facts['episodes']} episodes, "
        f"{facts['diverged']} diverged. Shedding frequencies: {shedding} per T.\n\n"
        "![Drift against tail beat](figures/gait/drift.png)"
    )


def write_lateral_line(folder: str, figures: Path) -> str:
    """Return a study of the lateral line, its headings one level deeper; copy its figures."""
    text = (Path(folder) / "lateral_line.md").read_text(encoding="utf-8")
    body = text.split("\n", 1)[1].replace("\n## ", "\n### ")
    for picture in sorted(Path(folder).glob("*.png")):
        name = f"line_{picture.name}"
        copyfile(picture, figures / name)
        body = body.replace(f"]({picture.name})", f"](figures/gait/{name})")
    return body


def write_transfer(folder: str, figures: Path, runs: Sequence[str], beside: str | None) -> str:
    """Return the tables of a transfer test; draw its figures and those of its trainings."""
    results = read(folder)
    others = read(beside)["arms"] if beside is not None else {}
    for name in FIGURES:
        copyfile(Path(folder) / f"{name}.png", figures / f"{name}.png")
    trials = [load_trial(Path(run)) for run in runs]
    by_arm: dict[str, list[Path]] = {}
    for run, trial in zip(runs, trials, strict=True):
        by_arm.setdefault(trial.arm, []).append(Path(run))
    pictures.write_training(figures / "training.png", by_arm)
    shown = next((trial for trial in trials if trial.arm == "both modules"), trials[0])
    periods_T = [1.0 / frequency for frequency in list_shedding(shown.task)]
    pictures.write_period(figures / "period.png", shown, num_decisions=8, periods_T=periods_T)
    return tables.write_results(results["arms"] | others, results["speeds_bl"])


def write_free_stream(folder: str, figures: Path, wake: str, arm: str) -> str:
    """Return the comparison of work with a transfer test, and draw its figure."""
    free, results = read(folder, "free_stream.json"), read(wake)
    speeds = free["speeds_bl"]
    rows = [
        [
            f"{speed:g}",
            f"{row['frequency']:.2f}",
            f"{row['drift']:+.4f}",
            f"{row['lean']:.1f}",
            f"{row['held']:.0f} of {row['episodes']:.0f}",
        ]
        for speed, row in zip(speeds, free["flows"], strict=True)
    ]
    held = write_table(("stream, L/T", "beats per T", "drift, L/T", "lean, °", "held"), rows)
    work = tables.write_work_table(results["arms"][arm], free["flows"], speeds)
    pictures.write_work(figures / "work.png", results["work"][arm], free["work"], speeds=speeds)
    note = f"Free stream: T = {free['steps_per_T']} steps, Mach {free['mach']:.2f}."
    return f"{held}\n{work}\n{note}"


@program(GaitPageSettings)
def main(settings: GaitPageSettings) -> None:
    """Write the parts that are given."""
    s, docs = settings, Path(settings.docs)
    page, figures = docs / "karman_gait.md", docs / "figures" / "gait"
    figures.mkdir(parents=True, exist_ok=True)
    if s.design:
        fill(page, "design", write_design(s.design))
    if s.fixed is not None:
        fill(page, "fixed", write_fixed(s.fixed))
    if s.drift is not None:
        fill(page, "drift", write_drift(s.drift, figures))
    if s.line is not None:
        fill(page, "lateral line", write_lateral_line(s.line, figures))
    if s.transfer is not None:
        fill(page, "transfer", write_transfer(s.transfer, figures, s.runs, s.beside))
        if s.free_stream is not None:
            fill(page, "work", write_free_stream(s.free_stream, figures, s.transfer, s.arm))
    print(f"written: {page}, {figures}")


if __name__ == "__main__":
    main()
