"""The page of a reproduction: the paper's tables, figures and numbers, next to ours."""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from shutil import copyfile
from typing import Any

import yaml
from markdown_it import MarkdownIt

from experiments.gait.tables import divide_work
from fishrl.files import staged, write_whole
from fishrl.pages import write_table
from fishrl.programs import view
from fishrl.programs.configuration import quote
from fishrl.programs.figures.learning_curve import Curve, draw_curves, read_metrics
from fishrl.programs.statistics import find_mean, show
from fishrl.programs.summarize import summarize
from fishrl.programs.sweeps.jobs import find_runs
from fishrl.programs.sweeps.runs import read_run
from fishrl.settings import flatten, to_plain
from fishrl.training.run_folder import read_config

#: Folder and name of each kind of policy in the second task.
ARMS = {
    "both": "both modules",
    "macro_actions": "macro-actions alone",
    "lateral_line": "lateral line alone",
    "ablation": "ablation",
}
#: Panels of the figure ``training``, and their columns of metrics.csv.
TRAINING = {
    "survival  [decisions], mean of 32": "train/episode_length",
    "return, mean of 32 episodes": "train/return",
    "actor loss": "train/loss_actor",
}
FILM_T = 24.0  # duration of the film of the second task, in which fish find their place
HEADS = ("quantity, in the flows I, II, III", "paper", "ours", "likely reason of a difference")


def find_fitted(folder: Path) -> Path | None:
    """Return the folder of the newest classifier whose fit is finished, or None."""
    fitted = folder.glob("classifier*/lateral_line.json")
    newest = max(fitted, key=lambda path: path.stat().st_mtime, default=None)
    return newest and newest.parent


def read_paper() -> Any:
    """Return the paper's numbers and settings, and the figures of the page."""
    return yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text(encoding="utf-8"))


def read(path: Path) -> Any:
    """Return the results in a JSON file; NaN where an entry is null."""

    def restore(entries: dict[str, Any]) -> dict[str, Any]:
        return {name: math.nan if entry is None else entry for name, entry in entries.items()}

    return json.loads(path.read_text(encoding="utf-8"), object_hook=restore)


def compare(transfer: Any, line: Any, captures: Sequence[float]) -> str:
    """Return each number of the paper next to ours, and why they may differ.

    ``captures`` are the mean times to capture of the predation policies, in T.
    """
    arms, speeds = transfer["arms"], transfer["speeds_bl"]
    both, ablation = arms[ARMS["both"]], arms[ARMS["ablation"]]
    works = zip(transfer["free_stream"]["flows"], both, strict=True)

    def write(form: str, values: Iterable[float]) -> str:
        return ", ".join(show(value, form) for value in values)

    rates = zip(transfer["shedding"], speeds, strict=True)
    ours = {
        "strouhal": write(".3f", (0.4 * rate / speed for rate, speed in rates)),
        "survival_ablation": write(".1f", (flow["survival_T"] for flow in ablation)),
        "survival_both": write(".1f", (flow["survival_T"] for flow in both)),
        "in_gait": write(".0%", (flow["in_gait"] for flow in both)),
        "frequency": write(".2f", (flow["frequency_over_shedding"] for flow in both)),
        "angle": write(".1f", (flow["angle_max"] for flow in both)),
        "work": write(".1f", (divide_work(*pair, "lateral_work") for pair in works)),
        "balance": "; ".join(
            write(".3f", (flow[name] for flow in both))
            for name in ("work", "positive_work", "torque_work", "total_work")
        ),
        "capture": find_mean(captures).show(".1f"),
        "fitted": f"{line['paper']['fitted_accuracy']:.0%}",
        "held_out": f"{line['paper']['held_out_accuracy']:.0%}",
        "own_held_out": f"{line['classifier']['held_out_accuracy']:.0%}",
    }
    rows = [
        [each["name"], each["paper"], ours[key], each.get("reason")]
        for key, each in read_paper()["quantities"].items()
    ]
    return write_table(HEADS, rows)


def list_settings(run: Path) -> str:
    """Return the hyper-parameters and flows of the second task, as tables 1 and 2 of the paper."""
    config = flatten(read_config(run / "config.yaml"))
    rows = [[name, value, config[key]] for name, value, key in read_paper()["settings"]]
    return write_table(("setting", "paper", "ours"), rows)


def draw(folder: Path, runs: Mapping[str, Sequence[Path]], pictures: Path) -> None:
    """Copy and draw the figures."""
    summarize(folder / "predation", paths=runs["predation"])
    pictures.mkdir(parents=True, exist_ok=True)
    places = {"folder": folder, "classifier": find_fitted(folder), "hunt": runs["predation"][0]}
    for name, figure in read_paper()["figures"].items():
        if "file" in figure:
            with staged(pictures / name) as stage:
                copyfile(figure["file"].format(**places), stage)
    curves = {
        title: [
            Curve(name, *metrics[column], number=number)
            for number, (arm, name) in enumerate(ARMS.items())
            for metrics in (read_metrics(run / "metrics.csv") for run in runs[arm])
            if column in metrics
        ]
        for title, column in TRAINING.items()
    }
    draw_curves(pictures / "training.png", curves)
    film = pictures / "gait.gif"
    words = [f"policy={quote(str(runs['both'][0]))}", f"periods={FILM_T}"]
    words.append(f"save={quote(str(film))}")
    view.main.run(view.main.read(words))


def write_page(folder: Path, stages: Mapping[str, Any], scale: Any) -> Path:
    """Write ``reproduction.md`` and ``reproduction.html`` with figures into the folder.

    Args:
        folder: of the reproduction, all stages finished.
        stages: from ``stages.json``.
        scale: settings of all programs.
    """
    runs = {arm: find_runs(stages[arm].words[2:]) for arm in ("predation", *ARMS)}
    draw(folder, runs, folder / "figures")
    transfer, fitted = read(folder / "transfer" / "transfer.json"), find_fitted(folder)
    assert fitted is not None  # its stage is finished
    times = [read_run(path).summary["mean_time_to_success_T"] for path in runs["predation"]]
    captures = [time for time in times if time is not None]  # None without a capture
    machines = {
        f"{m['gpu'] or m['cpu']}, {m['cores']} cores, torch {m['torch']}"
        for m in (stage.machine for stage in stages.values())
    }
    hours = {name: stage.seconds / 3600 for name, stage in stages.items()}
    spent = [[name, stages[name].words[0], f"{hours[name]:.2f}"] for name in stages]
    shown = {name: figure["caption"] for name, figure in read_paper()["figures"].items()}
    parts = [
        f"# Reproduction, {scale.name}",
        f"{sum(hours.values()):.1f} hours on {'; '.join(sorted(machines))}. Settings:",
        f"```yaml\n{yaml.safe_dump(to_plain(asdict(scale)), sort_keys=False)}```",
        "## The paper's numbers and ours",
        compare(transfer, read(fitted / "lateral_line.json"), captures),
        "## Settings of the second task",
        list_settings(runs["both"][0]),
        "## Task 1: predation",
        (folder / "predation" / "summary.md").read_text(encoding="utf-8").partition("\n")[2],
        "## Task 2: Kármán gait",
        (folder / "transfer" / "transfer.md").read_text(encoding="utf-8"),
        "## Figures",
        *(f"![{text}](figures/{name})\n\n*{text}*" for name, text in shown.items()),
        "## Stages",
        write_table(("stage", "program", "hours"), spent),
    ]
    text = "\n\n".join(part.strip() for part in parts) + "\n"
    write_whole(folder / "reproduction.md", text)
    html = MarkdownIt("commonmark", {"html": False}).enable("table").render(text)
    page = folder / "reproduction.html"
    write_whole(page, f"<!doctype html><meta charset='utf-8'>{html}")
    return page
