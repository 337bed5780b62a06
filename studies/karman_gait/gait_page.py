"""Write generated parts of the pages of the Kármán gait: ``python -m experiments.gait_page``."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from shutil import copyfile
from statistics import fmean
from typing import Any

from experiments.gait import figures, tables
from experiments.gait.trials import list_shedding, load_trial
from experiments.gait_forces import find_thrust_phase
from experiments.pages import fill, write_table
from experiments.program import program
from experiments.statistics import show
from fishrl.training.policy_zoo import find_folder

#: Time before the first moment of the figure of a period, in which fish find their place, T.
SETTLED_T = 20.0
#: Parts of gait_studies.md; the others are those of karman_gait.md.
STUDIES = ("design", "fixed", "drift", "forces", "lateral line")
COPIED = ("survival", "paths", "places", "decisions", "lean")


@dataclass(kw_only=True)
class GaitPageSettings:
    """Settings of the pages; parts without a folder are left unchanged.

    Args:
        docs: folder of the documentation.
        design: folders of ``experiments.transfer`` with baseline pid, by the name of their task.
        fixed: folder of ``experiments.transfer`` with baselines of one frequency.
        drift: folder of ``experiments.drift_sweep``.
        forces: folder of ``experiments.gait_forces``.
        line: run folder of ``experiments.train_lateral_line``.
        transfer: folder of ``experiments.transfer``.
        part: of the page that ``transfer`` fills; any other than ``transfer`` also begins the names
            of its figures and of the part and figure of work.
        runs: run folders of ``transfer`` and ``zoo/<name>``; the first policy swims in the figure
            of a period.
        beside: folder of another transfer test, whose policies are appended to the tables.
        robustness: folder of ``experiments.robustness``.
        free_stream: folder of ``experiments.free_stream``, whose work is compared with that of the
            first policy of ``transfer``.
    """

    docs: str = "docs"
    design: dict[str, str] = field(default_factory=dict)
    fixed: str | None = None
    drift: str | None = None
    forces: str | None = None
    line: str | None = None
    transfer: str | None = None
    part: str = "transfer"
    runs: tuple[str, ...] = ()
    beside: str | None = None
    robustness: str | None = None
    free_stream: str | None = None

    def __post_init__(self) -> None:
        """Check that the parts of the transfer test come together."""
        if self.transfer is None and (self.runs or self.free_stream):
            raise ValueError("runs and free_stream: give transfer too")


def read(folder: str, name: str = "transfer.json") -> Any:
    """Return the results in a folder; NaN where there is null."""

    def restore(value: Any) -> Any:
        if isinstance(value, dict):
            return {name: restore(entry) for name, entry in value.items()}
        if isinstance(value, list):
            return [restore(entry) for entry in value]
        return math.nan if value is None else value

    return restore(json.loads((Path(folder) / name).read_text(encoding="utf-8")))


def write_drift(folder: str, pictures: Path) -> str:
    """Return the settings of a drift sweep, and copy its figure."""
    facts = read(folder, "drift.json")
    shedding = ", ".join(f"{value:.3f}" for value in facts["shedding_frequencies_per_T"])
    copyfile(Path(folder) / "drift.png", pictures / "drift.png")
    return (
        f"L = {facts['body_length']}, Re_f = {facts['reynolds']:g}, {facts['steps_per_T']} steps "
        f"per T, τ = {facts['tau']:.4f}, Mach {facts['mach']:.2f}; {facts['episodes']} episodes, "
        f"{facts['diverged']} diverged. Shedding frequencies: {shedding} per T.\n\n"
        "![Drift against tail beat](figures/gait/drift.png)"
    )


def read_speeds(name: str, *results: Any) -> list[float]:
    """Return the stream speeds that all results have in common; ValueError if they differ."""
    speeds = [list(each["speeds_bl"]) for each in results]
    if any(each != speeds[0] for each in speeds):
        raise ValueError(f"{name}: results in different streams, {speeds} L/T")
    return speeds[0]


def write_forces(folder: str, pictures: Path) -> str:
    """Return a table of the force on a held fish by frequency and phase, and copy the figure."""
    with (Path(folder) / "forces.csv").open(encoding="utf-8") as file:
        found = [{name: float(v) for name, v in row.items()} for row in csv.DictReader(file)]
    copyfile(Path(folder) / "forces.png", pictures / "forces.png")
    found = [row for row in found if not row["diverged"]]
    ratios = sorted({row["ratio"] for row in found})
    rows = []
    for speed, x in sorted({(row["stream_speed_bl"], row["x_bl"]) for row in found}):
        mine = [row for row in found if (row["stream_speed_bl"], row["x_bl"]) == (speed, x)]
        forces = [[row["force_x"] for row in mine if row["ratio"] == ratio] for ratio in ratios]
        means = [f"{fmean(values):+.3f}" if values else "–" for values in forces]
        locked = [row for row in mine if row["ratio"] == 1.0]
        extremes = thrust = "–"
        if locked:
            by_phase = [row["force_x"] for row in locked]
            extremes = f"{min(by_phase):+.3f} to {max(by_phase):+.3f}"
            thrust = show(math.degrees(find_thrust_phase(locked)), ".0f")
        rows.append([f"{speed:g}", f"{x:g}", *means, extremes, thrust])
    heads = ["stream, L/T", "x, L", *(f"{ratio:g} f" for ratio in ratios)]
    text = write_table([*heads, "1 f, by phase", "thrust at, °"], rows)
    return f"{text}\n![Force on a held fish](figures/gait/forces.png)"


def take_page(page: Path, pictures: Path, *, prefix: str = "") -> str:
    """Return a page of Markdown; copy the figures beside it that it shows."""
    text = page.read_text(encoding="utf-8")
    for picture in page.parent.glob("*.png"):
        if (link := f"]({picture.name})") in text:
            copyfile(picture, pictures / f"{prefix}{picture.name}")
            text = text.replace(link, f"](figures/gait/{prefix}{picture.name})")
    return text


def draw_transfer(results: str, runs: Sequence[str], pictures: Path, *, prefix: str = "") -> None:
    """Copy the figures of a transfer test but that of work, and draw those of its trainings."""
    for name in COPIED:
        copyfile(Path(results) / f"{name}.png", pictures / f"{prefix}{name}.png")
    by_arm: dict[str, list[Path]] = {}
    folders = [find_folder(run) for run in runs]
    trials = [load_trial(folder) for folder in folders]
    for folder, trial in zip(folders, trials, strict=True):
        by_arm.setdefault(trial.arm, []).append(folder)
    if trials:
        figures.write_training(pictures / f"{prefix}training.png", by_arm)
        task, path = trials[0].task, pictures / f"{prefix}period.png"
        periods_T = [1.0 / frequency for frequency in list_shedding(task)]
        lead = task.count_decisions(SETTLED_T)
        figures.write_period(path, trials[0], num_decisions=lead, periods_T=periods_T)


def write_free_stream(free: Any, in_wake: Any) -> str:
    """Return the comparison of work with a transfer test."""
    form = "{frequency:.2f}|{drift:+.4f}|{lean:.1f}|{held} of {episodes}"
    flows = zip(free["speeds_bl"], free["flows"], strict=True)
    rows = [[f"{speed:g}", *form.format(**flow).split("|")] for speed, flow in flows]
    held = write_table(("stream, L/T", "beats per T", "drift, L/T", "lean, °", "held"), rows)
    work = tables.write_work(in_wake, free["flows"], free["speeds_bl"])
    return f"{held}\n{work}\nFree stream: T = {free['steps_per_T']} steps, Mach {free['mach']:.2f}."


@program(GaitPageSettings)
def main(settings: GaitPageSettings) -> None:
    """Write the parts that are given."""
    s, docs, parts = settings, Path(settings.docs), dict[str, str]()
    pictures = docs / "figures" / "gait"
    pictures.mkdir(parents=True, exist_ok=True)
    if s.design:
        found = {name: read(folder) for name, folder in s.design.items()}
        rows = {name: results["arms"]["pid"] for name, results in found.items()}
        speeds = read_speeds("design", *found.values())
        parts["design"] = tables.write_survival("task", rows, speeds)
    if s.fixed is not None:
        results = read(s.fixed)
        parts["fixed"] = tables.write_survival("policy", results["arms"], results["speeds_bl"])
    if s.drift is not None:
        parts["drift"] = write_drift(s.drift, pictures)
    if s.forces is not None:
        parts["forces"] = write_forces(s.forces, pictures)
    if s.line is not None:
        text = take_page(Path(s.line) / "lateral_line.md", pictures, prefix="line_")
        parts["lateral line"] = text.split("\n", 1)[1].replace("\n## ", "\n### ")
    if s.robustness is not None:
        parts["robustness"] = take_page(Path(s.robustness) / "robustness.md", pictures)
    if s.transfer is not None:
        results = read(s.transfer)
        beside = read(s.beside) if s.beside else results | {"arms": {}}
        others, speeds = beside["arms"], read_speeds("beside", results, beside)
        if both := sorted(results["arms"].keys() & others):
            raise ValueError(f"beside: transfer has {', '.join(both)} too; give other policies")
        prefix = "" if s.part == "transfer" else f"{s.part}_"
        draw_transfer(s.transfer, s.runs, pictures, prefix=prefix)
        parts[s.part] = tables.write_results(results["arms"] | others, speeds)
        if s.free_stream is not None:
            free = read(s.free_stream, "free_stream.json")
            read_speeds("free_stream", results, free)
            in_wake, work = (next(iter(results[name].values())) for name in ("arms", "work"))
            parts[f"{prefix}work"] = write_free_stream(free, in_wake)
            path = pictures / f"{prefix}work.png"
            figures.write_work(path, work, free["work"], speeds=speeds)
    for name, text in parts.items():
        page = docs / ("gait_studies.md" if name in STUDIES else "karman_gait.md")
        fill(page, name, text)
        print(f"written: {name} of {page}")
    print(f"figures: {pictures}")


if __name__ == "__main__":
    main()
