"""The results of a fit: as numbers, as a page, and as figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter
from tensordict import TensorDict

from fishrl.programs.figures.style import COLOURS, panels
from fishrl.programs.lateral_line.fitting import Fit
from fishrl.programs.pages import write_table

_PERCENT = FuncFormatter(lambda value, _: f"{value:.0%}")
_NAMES = {
    "classifier": "this one",
    "paper": "as in the paper: [t, x, y, u_x, u_y, p, speed], mean, instant",
}


def describe(episodes: TensorDict, fits: Mapping[str, Fit]) -> dict[str, Any]:
    """Return the numbers of the data and of ``classifier`` and, if fitted, ``paper``."""
    is_decision, classifier = episodes["is_decision"], fits["classifier"].classifier
    sample_T = classifier.sensors["interval_T"]
    return {
        "flows": list(classifier.flows),
        "sensors": classifier.sensors,
        "features": classifier.features,
        "window_T": classifier.num_samples * sample_T,
        "chance": 1.0 / len(classifier.flows),
        "data": {
            "samples": int(is_decision.sum()),
            "episodes": len(episodes),
            "decisions_per_episode": float(is_decision.sum(1).double().mean()),
            "sample_T": sample_T,
        },
        **{name: _describe_fit(fit) for name, fit in fits.items()},
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
"""


def write_page(findings: Mapping[str, Any]) -> str:
    """Return the Markdown page of findings as ``describe`` returns."""
    form = "{fitted_accuracy:.1%}|{held_out_accuracy:.1%}|{held_out_samples} of "
    form += "{held_out_episodes} episodes|{number} of {epochs}"
    rows = [
        [name, *form.format(**fit, number=fit["chosen_epoch"] + 1).split("|")]
        for key, name in _NAMES.items()
        if (fit := findings.get(key)) is not None
    ]
    return _PAGE.format(
        flows=", ".join(flow["name"] for flow in findings["flows"]),
        chance=findings["chance"],
        **findings["data"],
        **{name: findings["sensors"][name] for name in ("num_samples", "num_neuromasts")},
        features=", ".join(findings["features"]),
        window_T=findings["window_T"],
        fits=write_table(("classifier", "fitted", "held-out episodes", "samples", "epochs"), rows),
    )


def write_figures(fits: Mapping[str, Fit], flows: Sequence[str], folder: Path) -> None:
    """Draw learning curves and confusion matrices of classifiers by name; ``flows`` are names."""
    chance, size = 1.0 / len(flows), (4.4 * len(fits), 3.9)
    with panels(folder / "curves.png", columns=2, size=(10, 3.8)) as grid:
        _draw_curves(grid[0], fits, chance=chance)
    with panels(folder / "confusion.png", columns=len(fits), size=size, has_grid=False) as grid:
        for axes, (name, fit) in zip(grid[0], fits.items(), strict=True):
            _draw_confusion(axes, fit, flows)
            axes.set_title(name)


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


def _draw_chance(axes: Axes, chance: float) -> None:
    axes.axhline(chance, color="#777777", linewidth=1.0, linestyle="--", zorder=1)
    axes.annotate(
        "chance", (0.0, chance), xycoords=("axes fraction", "data"), xytext=(4, 3),
        textcoords="offset points", fontsize=8, color="#555555",
    )  # fmt: skip
