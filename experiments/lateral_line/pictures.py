"""The study in figures: learning curves, confusion matrices, and limits of the signal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter

from experiments.figures.style import COLOURS, panels, tidy
from experiments.lateral_line.study import Fit

_PERCENT = FuncFormatter(lambda value, _: f"{value:.0%}")


def write_figures(findings: Mapping[str, Any], fits: Mapping[str, Fit], folder: Path) -> None:
    """Write all figures of a study.

    Args:
        findings: as ``report.describe`` returns.
        fits: classifiers to compare, by name.
        folder: that takes the files.
    """
    write_curves(folder / "curves.png", fits, chance=findings["chance"])
    names = [flow["name"] for flow in findings["flows"]]
    write_confusion(folder / "confusion.png", fits, names=names)
    write_limits(folder / "limits.png", findings)


def write_curves(path: Path, fits: Mapping[str, Fit], *, chance: float) -> None:
    """Draw accuracy and loss against epochs, fitted and held out, one colour per classifier."""
    with panels(path, columns=2, size=(10, 3.8)) as grid:
        left, right = grid[0]
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
        for axes in grid[0]:
            axes.set(xlabel="epoch", xscale="log")
            tidy(axes)
        title = "dotted: training episodes · line: validation episodes · dot: kept"
        left.legend(
            loc="lower right", fontsize=8.5, title=title, title_fontsize=8.5, alignment="left"
        )


def write_confusion(path: Path, fits: Mapping[str, Fit], *, names: Sequence[str]) -> None:
    """Draw the confusion matrix of each classifier on held-out episodes."""
    with panels(path, columns=len(fits), size=(4.4 * len(fits), 3.9)) as grid:
        for axes, (name, fit) in zip(grid[0], fits.items(), strict=True):
            count = fit.held_out.confusion.double().numpy()
            share = count / np.maximum(count.sum(1, keepdims=True), 1.0)
            axes.imshow(share, cmap="Blues", vmin=0.0, vmax=1.0)
            for (row, column), value in np.ndenumerate(share):
                axes.text(
                    column, row, f"{value:.0%}\n{int(count[row, column])}", ha="center",
                    va="center", fontsize=9, color="white" if value > 0.6 else "#222222",
                )  # fmt: skip
            axes.set(xlabel="predicted", ylabel="true flow", title=name)
            axes.set_xticks(range(len(names)), names)
            axes.set_yticks(range(len(names)), names)
            axes.spines[:].set_visible(False)
            axes.tick_params(length=0)


def write_limits(path: Path, findings: Mapping[str, Any]) -> None:
    """Draw held-out accuracy against window length, noise, and decisions by memory."""
    windows, sample_T = findings["windows"]["accuracy"], findings["data"]["sample_T"]
    with panels(path, columns=3, size=(12, 3.6), sharey=True) as grid:
        first, second, third = grid[0]
        _draw_answers(first, windows, COLOURS[0], scale=sample_T)
        first.set(xlabel="window  [T]", ylabel="accuracy on held-out episodes", xscale="log")
        lengths = [sample_T * int(key) for key in windows]
        first.set_xticks(lengths, [f"{length:.2g}" for length in lengths])
        first.minorticks_off()
        for (name, answers), colour in zip(findings["noise"].items(), COLOURS, strict=False):
            _draw_answers(second, answers, colour, label=name)
        second.set(xlabel="noise / standard deviation of the feature")
        for (name, means), colour in zip(findings["by_decision"].items(), COLOURS, strict=False):
            answers = {number: [mean] for number, mean in means.items()}
            _draw_answers(third, answers, colour, label=f"memory {name}")
        third.set(xlabel="decisions since the start")
        for axes in (second, third):
            axes.legend(loc="lower right", fontsize=8.5)
        first.set_ylim(0.0, 1.03)
        first.yaxis.set_major_formatter(_PERCENT)
        for axes in grid[0]:
            _draw_chance(axes, findings["chance"])
            tidy(axes)


def _draw_answers(
    axes: Axes,
    answers: Mapping[str, Sequence[float]],
    colour: str,
    *,
    scale: float = 1.0,
    label: str | None = None,
) -> None:
    """Draw the mean over the splits, and a band from the least to the largest."""
    x = scale * np.array([float(key) for key in answers])
    values: Any = np.array(list(answers.values()))
    axes.fill_between(x, values.min(1), values.max(1), color=colour, alpha=0.18, linewidth=0)
    axes.plot(x, values.mean(1), "o-", color=colour, markersize=4, linewidth=1.5, label=label)


def _draw_chance(axes: Axes, chance: float) -> None:
    axes.axhline(chance, color="#777777", linewidth=1.0, linestyle="--", zorder=1)
    axes.annotate(
        "chance", (0.0, chance), xycoords=("axes fraction", "data"), xytext=(4, 3),
        textcoords="offset points", fontsize=8, color="#555555",
    )  # fmt: skip
