"""Compare algorithms at equal effort: ``python -m experiments.compare --seeds 0 1 2 3 4``.

Trains each algorithm with each seed, with settings as for ``experiments.train``
(``preset=small total_frames=2800 eval_frames=350``, ``--config-dir <folder>``), and writes
``compare.png``, ``compare.md`` and ``compare.json``: learning curves and what they say, with 95 %
intervals over the seeds. After an interruption the same command goes on; what is trained already is
not trained again.
"""

from __future__ import annotations

import argparse
import json
import logging
import sys
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from shutil import copyfile
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from experiments.command_line import plain_errors, set_up_logging
from experiments.config import load_config, resumed_settings
from experiments.figures import COLOURS, STYLE, frame_curves, read_metrics
from experiments.pages import fill
from experiments.settings import ConfigError, TrainConfig
from experiments.statistics import half_width
from experiments.sweeps.jobs import find_difference
from experiments.train import begin_run, finish, set_up
from fishrl.training.interruption import Interrupted
from fishrl.training.progress import Progress
from fishrl.training.run_folder import RunFolder, write_json, write_whole

logger = logging.getLogger(__name__)

ALGORITHMS = ("discrete_sac", "dqn", "double_dqn", "drqn")
#: What a learning curve shows: column of metrics.csv, and its title.
CURVES = {"eval/success_rate": "rate of success", "eval/mean_return": "return per episode"}

Results = dict[str, list[dict[str, Any]]]


def compare(
    algorithms: Sequence[str],
    *,
    seeds: Sequence[int],
    folder: Path,
    overrides: Sequence[str] = (),
    make_env: Any = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Train what is not trained yet, and compare the first algorithm with each other one.

    Args:
        algorithms: names of the config group ``algorithm``.
        seeds: one run of each algorithm for each.
        folder: where the runs and the comparison go.
        overrides: settings of all runs, as for ``experiments.train``.
        make_env: makes the env of a task; by default ``fishrl.envs.flow_env.make_env``.
        progress: the bar.

    Returns:
        What ``compare.json`` holds.

    Raises:
        ValueError: if a run in the folder was made with other settings or does not name them, or
            efforts differ.
        Interrupted: if the program was told to end.
    """
    for name, values in (("algorithms", algorithms), ("seeds", seeds)):
        if len(set(values)) < len(values) or not values:
            raise ConfigError(f"{name} = {list(values)}: give one or more different ones")
    runs: Results = {algorithm: [] for algorithm in algorithms}
    for seed in seeds:
        for algorithm in algorithms:
            given = [*overrides, f"algorithm={algorithm}", f"seed={seed}"]
            config = load_config("train", [*given, f"folder={folder}", "picture_episodes=0"])
            config.name = f"{algorithm}-seed{seed}"
            if runs[algorithms[0]]:
                config.baselines = []  # once is enough
            runs[algorithm].append(_train(config, folder / config.name, make_env, progress))
    _check_effort(runs)
    result = summarise(runs)
    write_json(folder / "compare.json", result)
    write_whole(folder / "compare.md", render(result))
    draw(runs, folder / "compare.png")
    return result


def _train(
    config: TrainConfig, run: Path, make_env: Any, progress: Progress | None
) -> dict[str, Any]:
    """Train, go on, or do nothing, and return summary and curves of a run."""
    folder = RunFolder(run)
    if folder.config.is_file():
        _check_settings(run, config)
    elif run.is_dir():  # ended before it wrote its settings
        if folder.has_begun() or folder.summary.is_file():
            raise ValueError(f"{run}: holds no config.yaml; delete it, or take another --folder")
        begin_run(config, folder.checked())
    if not folder.summary.is_file():
        if run.is_dir():
            config = resumed_settings(str(run), [])
            config.resume = str(run)
        training = set_up(config, make_env=make_env, progress=progress)
        with training.interruption:
            finish(training)
    summary: dict[str, Any] = json.loads(folder.summary.read_text(encoding="utf-8"))
    series = read_metrics(folder.metrics)
    return {"summary": summary, "curves": {column: series[column] for column in CURVES}}


def _check_settings(run: Path, config: TrainConfig) -> None:
    difference = find_difference(config, run)
    if difference is not None:
        name, known, wanted = difference
        raise ValueError(
            f"{run}: was run with {name} = {known!r}, here it is {wanted!r}: take "
            "another --folder, or the settings of before"
        )


def _check_effort(runs: Results) -> None:
    efforts = {
        (run["summary"]["frames"], run["summary"]["updates"])
        for some in runs.values()
        for run in some
    }
    if len(efforts) > 1:
        raise ValueError(
            f"runs differ in (frames, updates): {sorted(efforts)}; compare runs of equal effort"
        )


def summarise(runs: Results) -> dict[str, Any]:
    """Reduce runs to means over seeds and half widths of their 95 % intervals.

    ``speed`` is a learning curve's mean over all evaluations: the earlier a fish succeeds, the
    greater. Differences of it are taken seed by seed, of the first algorithm and each other one.
    """
    algorithms: dict[str, Any] = {}
    speeds: dict[str, list[float]] = {}
    for name, some in runs.items():
        rates = [run["curves"]["eval/success_rate"] for run in some]
        speeds[name] = [float(values.mean()) for _, values in rates]
        halves = [frames[values >= 0.5] for frames, values in rates]
        final = [run["summary"]["success_rate"] for run in some]
        returns = [run["summary"]["mean_return"] for run in some]
        algorithms[name] = {
            "speed": _mean(speeds[name]),
            "success_rate": _mean(final),
            "mean_return": _mean(returns),
            "frames_to_half": [float(found[0]) if found.size else None for found in halves],
        }
    first = next(iter(runs))
    differences = {
        name: _mean([a - b for a, b in zip(speeds[first], speeds[name], strict=True)])
        for name in runs
        if name != first
    }
    summary = next(iter(runs.values()))[0]["summary"]
    return {
        "frames": summary["frames"],
        "updates": summary["updates"],
        "num_seeds": len(speeds[first]),
        "algorithms": algorithms,
        "first": first,
        "differences_of_speed": differences,
        "baselines": {name: summary[f"{name}_success_rate"] for name in summary["baselines"]},
    }


def _mean(values: Sequence[float]) -> list[float | None]:
    """Return mean and half width of the 95 % interval, None where one seed gives none."""
    half = half_width(values)
    return [float(np.mean(values)), None if half != half else half]


def judge(difference: Sequence[float | None]) -> str:
    """Say what a difference of speed means."""
    mean, half = difference
    if mean is None or half is None or abs(mean) <= half:
        return "undecided"
    return "faster" if mean > 0 else "slower"


def render(result: Mapping[str, Any]) -> str:
    """Return the tables as Markdown."""
    lines = [
        f"{result['num_seeds']} seeds, {result['frames']} frames and {result['updates']} gradient "
        "steps each; mean ± half the 95 % interval over seeds.",
        "",
        "| algorithm | mean of the curve | success at the end | return at the end | half succeed |",
        "|---|---|---|---|---|",
    ]
    for name, row in result["algorithms"].items():
        reached = [frames for frames in row["frames_to_half"] if frames is not None]
        half = f"{np.mean(reached):.0f} frames, " if reached else ""
        lines.append(
            f"| {name} | {_show(row['speed'])} | {_show(row['success_rate'])} "
            f"| {_show(row['mean_return'])} "
            f"| {half}{len(reached)} of {result['num_seeds']} seeds |"
        )
    for name, rate in result["baselines"].items():
        lines.append(f"| {name} (hand-written) | | {rate:.2f} | | |")
    lines += [
        "",
        f"| {result['first']} against | difference of the means | it is |",
        "|---|---|---|",
    ]
    for name, difference in result["differences_of_speed"].items():
        lines.append(f"| {name} | {_show(difference)} | {judge(difference)} |")
    return "\n".join(lines) + "\n"


def _show(pair: Sequence[float | None]) -> str:
    mean, half = pair
    return f"{mean:.2f}" + ("" if half is None else f" ± {half:.2f}")


def draw(runs: Results, path: Path) -> None:
    """Draw learning curves: thin those of the seeds, thick their mean, its 95 % interval behind."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(11, 4.2), layout="constrained")
        for axes, (column, title) in zip(
            figure.subplots(1, len(CURVES)), CURVES.items(), strict=True
        ):
            for (name, some), colour in zip(runs.items(), COLOURS, strict=False):
                frames = some[0]["curves"][column][0]
                values = np.array([run["curves"][column][1] for run in some])
                mean = values.mean(0)
                half = np.nan_to_num([half_width(list(at)) for at in values.T])
                axes.plot(
                    frames, mean, color=colour, label=name.replace("_", " "), marker="o", ms=3
                )
                axes.plot(frames, values.T, color=colour, lw=0.8, alpha=0.35)
                axes.fill_between(frames, mean - half, mean + half, color=colour, alpha=0.08, lw=0)
            is_rate = column == "eval/success_rate"
            frame_curves(axes, title, is_rate=is_rate)
            if is_rate:
                axes.legend(loc="best", fontsize=9)
        figure.savefig(path)


def write_page(folder: Path, docs: Path) -> None:
    """Put table and curves of a comparison into docs/algorithms.md."""
    table = (folder / "compare.md").read_text(encoding="utf-8")
    fill(docs / "algorithms.md", "compare", table)
    copyfile(folder / "compare.png", docs / "figures" / "compare.png")


def read_arguments(words: Sequence[str]) -> argparse.Namespace:
    """Read the command line; settings may stand anywhere, also behind ``--seeds 0 1``."""
    parser = argparse.ArgumentParser(description="Compare algorithms at equal effort.")
    parser.add_argument("--algorithms", nargs="+", default=list(ALGORITHMS), metavar="NAME")
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2, 3, 4])
    parser.add_argument("--folder", type=Path, default=Path("runs/compare"))
    parser.add_argument("--docs", type=Path, help="folder of the pages to put the result into")
    parser.add_argument("--config-dir", metavar="FOLDER", help="of tasks and presets of one's own")
    parser.add_argument("settings", nargs="*", help="of every run, such as preset=small")
    settings: list[str] = []
    others: list[str] = []
    for before, word in pairwise(["", *words]):
        is_value = before in ("--folder", "--config-dir", "--docs") or word.startswith("-")
        (settings if "=" in word and not is_value else others).append(word)
    options = parser.parse_intermixed_args(others)
    places = [f"--config-dir={options.config_dir}"] if options.config_dir is not None else []
    options.settings = [*places, *settings, *options.settings]
    return options


def main() -> None:
    """Read the command line."""
    options = read_arguments(sys.argv[1:])
    set_up_logging()
    with plain_errors(), Progress() as progress:
        try:
            compare(
                options.algorithms,
                seeds=options.seeds,
                folder=options.folder,
                overrides=options.settings,
                progress=progress,
            )
        except Interrupted as end:
            print(f"{end}: saved; the same command goes on", file=sys.stderr)
            sys.exit(128 + end.number)
        except OSError as error:
            sys.exit(f"error: {error}\nthe same command goes on")
        if options.docs is not None:
            write_page(options.folder, options.docs)
    print((options.folder / "compare.md").read_text(encoding="utf-8"))


if __name__ == "__main__":
    main()
