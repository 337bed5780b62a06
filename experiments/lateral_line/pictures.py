"""The study in pictures: how fits go, what is mistaken for what, and what windows and noise do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from experiments.figures import COLOURS, STYLE
from experiments.lateral_line.findings import Answers
from fishrl.objectives import Curves

_PERCENT = FuncFormatter(lambda value, _: f"{value:.0%}")


def write_curves(curves: Mapping[str, Curves], path: Path, *, chance: float) -> None:
    """Draw accuracy and loss against epochs, fitted and held out, one colour per machine.

    Args:
        curves: of each machine, by name.
        path: of the PNG.
        chance: accuracy of guessing.
    """
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(10, 3.8), layout="constrained")
        left, right = figure.subplots(1, 2)
        for (name, curve), colour in zip(curves.items(), COLOURS, strict=False):
            epoch = np.arange(1, len(curve.train_loss) + 1)
            for axes, fitted, unseen in (
                (left, curve.train_accuracy, curve.validation_accuracy),
                (right, curve.train_loss, curve.validation_loss),
            ):
                axes.plot(epoch, fitted, color=colour, linewidth=1.0, linestyle=":")
                axes.plot(epoch, unseen, color=colour, linewidth=1.5, label=name)
                at = curve.chosen_epoch
                axes.plot(epoch[at], unseen[at], "o", color=colour, markersize=5)
        _draw_chance(left, chance)
        right.axhline(-np.log(chance), color="#777777", linewidth=1.0, linestyle="--", zorder=1)
        left.set(ylabel="accuracy", ylim=(0.0, 1.03))
        right.set(ylabel="cross-entropy  [nats]", ylim=(0.0, 2.0 * -np.log(chance)))
        left.yaxis.set_major_formatter(_PERCENT)
        for axes in (left, right):
            axes.set(xlabel="epoch", xscale="log")
            _tidy(axes)
        left.legend(
            loc="lower right", fontsize=8.5, title_fontsize=8.5, alignment="left",
            title="dotted: episodes fitted on · line: unseen episodes · dot: kept",
        )  # fmt: skip
        figure.savefig(path)


def write_confusion(
    confusions: Mapping[str, Sequence[Sequence[int]]], path: Path, *, names: Sequence[str]
) -> None:
    """Draw which flow is taken for which, one panel per machine.

    Args:
        confusions: counts ``[n, n]``, true flows in rows, by name of the machine.
        path: of the PNG.
        names: of the flows.
    """
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(4.4 * len(confusions), 3.9), layout="constrained")
        grid = figure.subplots(1, len(confusions), squeeze=False)
        for axes, (name, counts) in zip(grid.flat, confusions.items(), strict=True):
            count = np.array(counts, dtype=float)
            share = count / np.maximum(count.sum(1, keepdims=True), 1.0)
            axes.imshow(share, cmap="Blues", vmin=0.0, vmax=1.0)
            for (row, column), value in np.ndenumerate(share):
                axes.text(
                    column, row, f"{value:.0%}\n{int(count[row, column])}", ha="center",
                    va="center", fontsize=9, color="white" if value > 0.6 else "#222222",
                )  # fmt: skip
            ticks = range(len(names))
            axes.set(xlabel="named", ylabel="true flow", title=name)
            axes.set_xticks(ticks, names)
            axes.set_yticks(ticks, names)
            axes.spines[:].set_visible(False)
            axes.tick_params(length=0)
        figure.savefig(path)


def write_limits(
    path: Path,
    *,
    windows: Answers,
    noise: Mapping[str, Answers],
    memory: Mapping[str, Mapping[str, float]],
    sample_T: float,
    chance: float,
) -> None:
    """Draw held-out accuracy against window length, noise, and decisions with and without memory.

    Args:
        path: of the PNG.
        windows: accuracies by number of samples.
        noise: accuracies by noise, by machine.
        memory: accuracies by decision, by memory.
        sample_T: time between samples in T.
        chance: accuracy of guessing.
    """
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(12, 3.6), layout="constrained")
        first, second, third = figure.subplots(1, 3, sharey=True)
        _draw_answers(first, windows, COLOURS[0], scale=sample_T)
        first.set(xlabel="window  [T]", ylabel="accuracy on unseen episodes", xscale="log")
        lengths = [sample_T * int(key) for key in windows]
        first.set_xticks(lengths, [f"{length:.2g}" for length in lengths])
        first.minorticks_off()
        for (name, answers), colour in zip(noise.items(), COLOURS, strict=False):
            _draw_answers(second, answers, colour, label=name)
        second.set(xlabel="noise / standard deviation of the feature")
        second.legend(loc="lower right", fontsize=8.5)
        for (name, shares), colour in zip(memory.items(), COLOURS, strict=False):
            decisions = [int(key) for key in shares]
            third.plot(
                decisions, list(shares.values()), "o-", color=colour, markersize=4,
                label=f"memory {name}",
            )  # fmt: skip
        third.set(xlabel="decisions since the start")
        third.legend(loc="lower right", fontsize=8.5)
        first.set_ylim(0.0, 1.03)
        first.yaxis.set_major_formatter(_PERCENT)
        for axes in (first, second, third):
            _draw_chance(axes, chance)
            _tidy(axes)
        figure.savefig(path)


def _draw_answers(
    axes: Axes, answers: Answers, colour: str, *, scale: float = 1.0, label: str | None = None
) -> None:
    """Draw the mean over the splits, and a band from the least to the largest."""
    x = scale * np.array([float(key) for key in answers])
    values: Any = np.array(list(answers.values()))
    axes.fill_between(x, values.min(1), values.max(1), color=colour, alpha=0.18, linewidth=0)
    axes.plot(x, values.mean(1), "o-", color=colour, markersize=4, linewidth=1.5, label=label)


def _draw_chance(axes: Axes, chance: float) -> None:
    axes.axhline(chance, color="#777777", linewidth=1.0, linestyle="--", zorder=1)
    axes.annotate(
        "guessing", (0.0, chance), xycoords=("axes fraction", "data"), xytext=(4, 3),
        textcoords="offset points", fontsize=8, color="#555555",
    )  # fmt: skip


def _tidy(axes: Axes) -> None:
    axes.grid(color="#e6e6e6", linewidth=0.7)
    axes.spines[["top", "right"]].set_visible(False)
