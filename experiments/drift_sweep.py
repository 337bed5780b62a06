"""How a fish drifts at each tail beat: ``python -m experiments.drift_sweep``.

In every flow fish beat at one frequency each, from several places and phases of the wake, with
steering; what they drift per T says which frequencies a row of gears needs: the lowest must let the
fish sink back, the highest must swim up. Writes a table (CSV), the figures behind it (JSON) and a
picture.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib as mpl
import torch
from matplotlib.figure import Figure

from experiments.command_line import plain_errors, set_up_logging
from experiments.figures import COLOURS, STYLE
from experiments.gait.histories import Histories, record_histories
from experiments.gait.trials import STARTS
from experiments.transfer import load_task
from experiments.validation.convergence import tidy
from fishrl.envs import KarmanGait, make_env
from fishrl.envs.macro_actions import DirectFrequencies
from fishrl.envs.stations import SafeArea
from fishrl.training.progress import Progress

FREQUENCIES = (0.0, 0.3, 0.6, 0.9, 1.2, 1.5, 1.8, 2.2, 2.6)
#: Distances behind the disc, body lengths, within which drift counts: near it a fish is sucked in
#: by the recirculation, far from it the wake carries less.
BANDS = ((0.8, 1.4), (1.4, 2.0), (2.0, 2.6), (2.6, 3.5))
COLUMNS = ("stream_speed_bl", "frequency", "from_bl", "to_bl", "drift", "error", "work", "samples")


def sweep(
    task: KarmanGait, frequencies: Sequence[float], *, num_starts: int, num_periods: int
) -> tuple[KarmanGait, Histories]:
    """Let ``num_starts`` fish beat at each frequency in each flow for ``num_periods`` T."""
    flows = len(task.stream.speeds_bl)
    per_flow = len(frequencies) * num_starts
    starts = task.sample_starts(flows * per_flow, torch.Generator().manual_seed(0))
    starts["flow_index"] = torch.arange(flows).repeat_interleave(per_flow)
    index = torch.arange(len(frequencies)).repeat_interleave(num_starts).repeat(flows)
    env = make_env(task=task, num_envs=len(index), starts=starts)
    num_decisions = round(num_periods / task.interval_T)
    with Progress() as progress:
        progress.start("drift", total=num_decisions)
        histories = record_histories(
            env,
            lambda state: state.set("action", index),
            starts,
            num_decisions=num_decisions,
            on_decision=lambda: progress.advance(1),
        )
    env.close()
    return task, histories


def tabulate(task: KarmanGait, histories: Histories) -> list[dict[str, float]]:
    """Return drift in L / T and work per T for each flow, frequency and band of distances.

    The first T of each episode is left out, in which the beat begins.
    """
    interval_T = task.interval_T
    x = histories.place[..., 0]
    steps = x.diff(dim=1) / interval_T
    ends = interval_T * torch.arange(1, x.shape[1])
    counted = (ends > 1.0 + 1e-6) & (ends <= histories.lengths_T[:, None] + 1e-6)  # uncut ones
    work = histories.work.diff(dim=1) / interval_T
    middle = 0.5 * (x[:, 1:] + x[:, :-1])
    table = []
    for flow, speed in enumerate(task.stream.speeds_bl):
        for frequency in histories.frequency[:, 0].unique().tolist():
            mine = (histories.flow == flow) & (histories.frequency[:, 0] == frequency)
            for low, high in BANDS:
                counts = (middle >= low) & (middle < high) & mine[:, None] & counted
                drift = steps[counts]
                table.append(
                    {
                        "stream_speed_bl": speed,
                        "frequency": frequency,
                        "from_bl": low,
                        "to_bl": high,
                        "drift": _mean(drift),
                        "error": float(drift.std() / len(drift) ** 0.5)
                        if len(drift) > 1
                        else math.nan,
                        "work": _mean(work[counts]),
                        "samples": len(drift),
                    }
                )
    return table


def _mean(values: torch.Tensor) -> float:
    return float(values.mean()) if len(values) else math.nan


def draw(task: KarmanGait, table: Sequence[dict[str, float]], shedding: Sequence[float]) -> Figure:
    """Draw drift against frequency, one panel per flow, one line per band of distances."""
    speeds = task.stream.speeds_bl
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(3.4 * len(speeds) + 0.6, 3.6), layout="constrained")
        grid = figure.subplots(1, len(speeds), sharey=True, squeeze=False)[0]
        for axes, speed, beat in zip(grid, speeds, shedding, strict=True):
            for colour, (low, high) in zip(COLOURS, BANDS, strict=False):
                rows = [
                    row for row in table
                    if (row["stream_speed_bl"], row["from_bl"]) == (speed, low)
                    and row["samples"] >= 3
                ]  # fmt: skip
                axes.errorbar(
                    [row["frequency"] for row in rows],
                    [row["drift"] for row in rows],
                    [row["error"] for row in rows],
                    color=colour, marker="o", markersize=3.5, capsize=2, linewidth=1.4,
                    label=f"nose {low:g}–{high:g} L behind the disc",
                )  # fmt: skip
            axes.axhline(0.0, color="#555555", linewidth=0.8)
            axes.axvline(beat, color="#999999", linewidth=0.8, linestyle=":")
            axes.set(title=f"stream {speed:g} L/T", xlabel="tail beats per T")
            tidy(axes)
        grid[0].set_ylabel("drift  [L/T]   (up: swept downstream)")
        handles, labels = grid[-1].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=len(BANDS), fontsize=8)
        figure.suptitle("dotted: shedding frequency; bars: standard error", fontsize=9)
    return figure


def main() -> None:
    """Sweep, write, draw."""
    parser = argparse.ArgumentParser(description="Drift of a fish against its tail beat.")
    parser.add_argument("--preset", default="gait_small", help="whose task it is")
    parser.add_argument("--frequencies", type=float, nargs="+", default=list(FREQUENCIES))
    parser.add_argument("--starts", type=int, default=6, help="fish per flow and frequency")
    parser.add_argument("--periods", type=int, default=8, help="T that each swims")
    parser.add_argument("--folder", type=Path, default=Path("runs/drift_sweep"))
    arguments = parser.parse_args()
    set_up_logging()
    with plain_errors():
        task = load_task(arguments.preset)
        task = replace(
            task,
            start_flows=tuple(range(len(task.stream.speeds_bl))),
            control=DirectFrequencies(frequencies=tuple(arguments.frequencies)),
            start_x_bl=(1.2, 2.6),
            start_y_bl=STARTS["start_y_bl"],
            safe_area=SafeArea(near_bl=0.4, far_bl=4.5),
        )
    task, histories = sweep(
        task, arguments.frequencies, num_starts=arguments.starts, num_periods=arguments.periods
    )
    table = tabulate(task, histories)
    assert task.wakes is not None
    shedding = (task.wakes.shedding_frequencies * task.scales.period).tolist()
    arguments.folder.mkdir(parents=True, exist_ok=True)
    write(arguments.folder, task, histories, table, shedding)
    print(f"written to {arguments.folder}: drift.csv, drift.json, drift.png")


def write(
    folder: Path,
    task: KarmanGait,
    histories: Histories,
    table: Sequence[dict[str, float]],
    shedding: Sequence[float],
) -> None:
    """Write table, settings and picture."""
    with (folder / "drift.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows({name: _round(value) for name, value in row.items()} for row in table)
    scales = task.scales
    settings: dict[str, Any] = {
        "body_length": scales.body_length,
        "reynolds": scales.reynolds,
        "steps_per_T": scales.period,
        "tau": scales.tau,
        "mach": scales.mach,
        "stream_speeds_bl": list(task.stream.speeds_bl),
        "shedding_frequencies_per_T": list(shedding),
        "steering": repr(task.steering),
        "episodes": len(histories.flow),
        "diverged": int(histories.diverged.sum()),
    }
    (folder / "drift.json").write_text(json.dumps(settings, indent=2) + "\n", encoding="utf-8")
    draw(task, table, shedding).savefig(folder / "drift.png")


def _round(value: float) -> float:
    return float(f"{value:.4g}")


if __name__ == "__main__":
    main()
