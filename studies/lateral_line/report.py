"""The results of a study: as numbers, as a page of tables, and as figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter

from experiments.figures.style import COLOURS, panels
from experiments.lateral_line.study import Answers, Fit, Study
from experiments.pages import write_table

_PERCENT = FuncFormatter(lambda value, _: f"{value:.0%}")
_PAPER = "as in the paper: [t, x, y, u_x, u_y, p, speed], mean, instant"


def describe(study: Study, fit: Fit, paper: Fit, tables: Mapping[str, Answers]) -> dict[str, Any]:
    """Return the numbers of a study: of its classifier, of the paper's, and those of ``answer``."""
    is_decision, sample_T = study.episodes["is_decision"], study.layout["interval_T"]
    by_decision = {
        memory: {number: float(np.mean(rows[number])) for number in sorted(rows, key=int)}
        for memory, rows in tables["by_decision"].items()
    }
    return {
        "flows": list(study.flows),
        "sensors": {name: fit.classifier.sensors[name] for name in study.layout},
        "features": fit.classifier.features,
        "window_T": fit.classifier.num_samples * sample_T,
        "chance": 1.0 / len(study.flows),
        "num_splits": study.settings.num_splits,
        "data": {
            "samples": int(is_decision.sum()),
            "episodes": len(study.episodes),
            "decisions_per_episode": float(is_decision.sum(1).double().mean()),
            "sample_T": sample_T,
        },
        "classifier": _describe_fit(fit),
        "paper": _describe_fit(paper),
        **tables,
        "by_decision": by_decision,
    }


def _describe_fit(fit: Fit) -> dict[str, Any]:
    return {
        "fitted_accuracy": fit.fitted.accuracy,
        "held_out_accuracy": fit.held_out.accuracy,
        "held_out_loss": fit.held_out.loss,
        "held_out_samples": len(fit.test),
        "held_out_episodes": int(fit.test["episode"].unique().numel()),
        "confusion": fit.held_out.confusion.tolist(),
        "epochs": len(fit.curves.train_loss),
        "chosen_epoch": fit.curves.chosen_epoch,
    }


_PAGE = """# Flow classification by the lateral line

Flows: {flows}; chance is {chance:.0%}. Accuracies are those on held-out episodes.

Data: {samples} decisions in {episodes} episodes; half of the actions are random, the other half
hold some station. There are {num_samples} samples per decision at {num_neuromasts} neuromasts. The
row of frequencies is drawn independently of the flow. Except for the classifier of the paper, the
mirror image of each sample is used in the fit, too.

{fits}
Input of this classifier: {features}, over {window_T:.3g} T.

![accuracy and loss](curves.png)

![confusion matrix](confusion.png)

![window, noise, memory](limits.png)

The classifiers of the tables below are fitted anew with the settings of this one, without noise
unless stated{divisions}; the same inputs therefore have other accuracies than above.

## Memory

Accuracy of predictions that accumulate the signals of an episode; with memory 0 only the current
signal is used.

{memory}
## Window

{windows}
## Noise

The noise is added to each feature, as a share of its standard deviation.

{noise}
## Leakage

Accuracy on data unlike those of the fit. *New starts* are those farthest downstream, none of which
is in the fit. *Later times* are decisions later in their episodes than any in the fit.

{leaks}
## Influence of the tail beat

After a wrong prediction, the tail-beat frequency is from the row of another flow. The last fit uses
only data with frequencies from the row of the true flow.

{rows}"""


def write_page(findings: Mapping[str, Any]) -> str:
    """Return the Markdown page of a study, of findings as ``describe`` returns."""
    num_splits, sample_T = findings["num_splits"], findings["data"]["sample_T"]
    divided = f", mean over {num_splits} divisions of the episodes [least-largest]"
    form = "{fitted_accuracy:.1%}|{held_out_accuracy:.1%}|{held_out_samples} of "
    form += "{held_out_episodes} episodes|{number} of {epochs}"
    fits = [
        [name, *form.format(**fit, number=fit["chosen_epoch"] + 1).split("|")]
        for name, fit in (("this one", findings["classifier"]), (_PAPER, findings["paper"]))
    ]
    corners = {"memory": "memory", "noise": "noise", "leaks": "input", "rows": "classifier"}
    corners["windows"] = "window (samples)"
    windows = findings["windows"]["accuracy"].items()
    in_T = {f"{int(length) * sample_T:.3g} T ({length})": values for length, values in windows}
    shown = {**findings, "windows": {"accuracy": in_T}}
    return _PAGE.format(
        flows=", ".join(flow["name"] for flow in findings["flows"]),
        chance=findings["chance"],
        divisions=divided if num_splits > 1 else "",
        **findings["data"],
        **{name: findings["sensors"][name] for name in ("num_samples", "num_neuromasts")},
        features=", ".join(findings["features"]),
        window_T=findings["window_T"],
        fits=write_table(("classifier", "fitted", "held-out episodes", "samples", "epochs"), fits),
        **{name: _tabulate(corner, shown[name]) for name, corner in corners.items()},
    )


def _tabulate(corner: str, columns: Answers) -> str:
    names = next(iter(columns.values()))
    rows = [[name, *(format_accuracies(c[name]) for c in columns.values())] for name in names]
    return write_table([corner, *columns], rows)


def format_accuracies(values: Sequence[float]) -> str:
    """Write mean and range, such as ``91.0% [88.1-93.2]``."""
    known = [value for value in values if value == value]
    if not known:
        return "-"
    mean = f"{sum(known) / len(known):.1%}"
    return mean + f" [{100 * min(known):.1f}-{100 * max(known):.1f}]" * (len(known) > 1)


def write_figures(findings: Mapping[str, Any], fits: Mapping[str, Fit], folder: Path) -> None:
    """Draw the figures of a study: findings as ``describe`` returns, and classifiers by name."""
    chance = findings["chance"]
    with panels(folder / "curves.png", columns=2, size=(10, 3.8)) as grid:
        _draw_curves(grid[0], fits, chance=chance)
    names, size = [flow["name"] for flow in findings["flows"]], (4.4 * len(fits), 3.9)
    with panels(folder / "confusion.png", columns=len(fits), size=size, has_grid=False) as grid:
        for axes, (name, fit) in zip(grid[0], fits.items(), strict=True):
            _draw_confusion(axes, fit, names)
            axes.set_title(name)
    with panels(folder / "limits.png", columns=3, size=(12, 3.6), sharey=True) as grid:
        _draw_limits(grid[0], findings)


def _draw_curves(grid: Sequence[Axes], fits: Mapping[str, Fit], *, chance: float) -> None:
    """Draw accuracy and loss against epochs, fitted and held out, one colour per classifier."""
    left, right = grid
    for (name, fit), colour in zip(fits.items(), COLOURS, strict=False):
        curve, at = fit.curves, fit.curves.chosen_epoch
        epoch = np.arange(1, len(curve.train_loss) + 1)
        for axes, fitted, held_out in (
            (left, curve.train_accuracy, curve.validation_accuracy),
            (right, curve.train_loss, curve.validation_loss),
        ):
            axes.plot(epoch, fitted, color=colour, linewidth=1.0, linestyle=":")
            axes.plot(epoch, held_out, color=colour, linewidth=1.5, label=name)
            axes.plot(epoch[at], held_out[at], "o", color=colour, markersize=5)
    _draw_chance(left, chance)
    right.axhline(-np.log(chance), color="#777777", linewidth=1.0, linestyle="--", zorder=1)
    left.set(ylabel="accuracy", ylim=(0.0, 1.03))
    right.set(ylabel="cross-entropy  [nats]", ylim=(0.0, 2.0 * -np.log(chance)))
    left.yaxis.set_major_formatter(_PERCENT)
    for axes in grid:
        axes.set(xlabel="epoch", xscale="log")
    title = "dotted: training episodes · line: validation episodes · dot: kept"
    small = {"fontsize": 8.5, "title_fontsize": 8.5}
    left.legend(loc="lower right", title=title, alignment="left", **small)


def _draw_confusion(axes: Axes, fit: Fit, names: Sequence[str]) -> None:
    """Draw the confusion matrix of a classifier on held-out episodes."""
    count = fit.held_out.confusion.double().numpy()
    share = count / np.maximum(count.sum(1, keepdims=True), 1.0)
    axes.imshow(share, cmap="Blues", vmin=0.0, vmax=1.0)
    for (row, column), value in np.ndenumerate(share):
        axes.text(
            column, row, f"{value:.0%}\n{int(count[row, column])}", ha="center",
            va="center", fontsize=9, color="white" if value > 0.6 else "#222222",
        )  # fmt: skip
    axes.set(xlabel="predicted", ylabel="true flow")
    axes.set_xticks(range(len(names)), names)
    axes.set_yticks(range(len(names)), names)
    axes.spines[:].set_visible(False)
    axes.tick_params(length=0)


def _draw_limits(grid: Sequence[Axes], findings: Mapping[str, Any]) -> None:
    """Draw held-out accuracy against window length, noise, and decisions by memory."""
    first, second, third = grid
    windows, sample_T = findings["windows"]["accuracy"], findings["data"]["sample_T"]
    _draw_answers(first, {"": windows}, scale=sample_T)
    first.set(xlabel="window  [T]", ylabel="accuracy on held-out episodes", xscale="log")
    lengths = [sample_T * int(key) for key in windows]
    first.set_xticks(lengths, [f"{length:.2g}" for length in lengths])
    first.minorticks_off()
    _draw_answers(second, findings["noise"])
    second.set(xlabel="noise / standard deviation of the feature")
    _draw_answers(third, {f"memory {n}": means for n, means in findings["by_decision"].items()})
    third.set(xlabel="decisions since the start")
    first.set_ylim(0.0, 1.03)
    first.yaxis.set_major_formatter(_PERCENT)
    for axes in grid:
        _draw_chance(axes, findings["chance"])


def _draw_answers(axes: Axes, columns: Mapping[str, Any], *, scale: float = 1.0) -> None:
    """Draw the mean over the splits, and a band from the least to the largest."""
    for (label, answers), colour in zip(columns.items(), COLOURS, strict=False):
        x = scale * np.array([float(key) for key in answers])
        values: Any = np.array(list(answers.values())).reshape(len(x), -1)
        axes.fill_between(x, values.min(1), values.max(1), color=colour, alpha=0.18, linewidth=0)
        axes.plot(x, values.mean(1), "o-", color=colour, markersize=4, linewidth=1.5, label=label)
    if len(columns) > 1:
        axes.legend(loc="lower right", fontsize=8.5)


def _draw_chance(axes: Axes, chance: float) -> None:
    axes.axhline(chance, color="#777777", linewidth=1.0, linestyle="--", zorder=1)
    axes.annotate(
        "chance", (0.0, chance), xycoords=("axes fraction", "data"), xytext=(4, 3),
        textcoords="offset points", fontsize=8, color="#555555",
    )  # fmt: skip
