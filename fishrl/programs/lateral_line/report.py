"""The accuracy of lateral-line classifiers: as numbers, as a table, and as figures."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from tensordict import TensorDict

from fishrl.pages import write_table
from fishrl.programs.figures.style import COLOURS, panels
from fishrl.programs.lateral_line.fitting import Fit

_HEADS = ("classifier", "fitted", "held-out episodes", "samples", "epochs")


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


def tabulate(fits: Mapping[str, Fit]) -> str:
    """Return a Markdown table of accuracies, a row per classifier."""
    rows = []
    for name, found in ((name, _describe_fit(fit)) for name, fit in fits.items()):
        accuracies = (f"{found[f'{part}_accuracy']:.1%}" for part in ("fitted", "held_out"))
        samples = f"{found['held_out_samples']} of {found['held_out_episodes']} episodes"
        rows.append(
            [name, *accuracies, samples, f"{found['chosen_epoch'] + 1} of {found['epochs']}"]
        )
    return write_table(_HEADS, rows)


def write_figures(fits: Mapping[str, Fit], folder: Path) -> None:
    """Draw learning curves (``curves.png``) and confusion matrices (``confusion.png``)."""
    names = [flow["name"] for flow in fits["classifier"].classifier.flows]
    with panels(folder / "curves.png", columns=2, size=(10, 3.8)) as grid:
        _draw_curves(grid[0], fits, chance=1.0 / len(names))
    size = (4.4 * len(fits), 3.9)
    with panels(folder / "confusion.png", columns=len(fits), size=size, has_grid=False) as grid:
        for axes, (name, fit) in zip(grid[0], fits.items(), strict=True):
            _draw_confusion(axes, fit, names)
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
    for axes, level in ((left, chance), (right, -np.log(chance))):
        axes.axhline(level, color="#777777", linestyle="--", zorder=1, label="chance")
        axes.set(xlabel="epoch", xscale="log")
    left.set(ylabel="accuracy", ylim=(0.0, 1.03))
    right.set(ylabel="cross-entropy  [nats]", ylim=(0.0, 2.0 * -np.log(chance)))
    left.yaxis.set_major_formatter("{x:.0%}")
    title = "dotted: training episodes · line: validation episodes · dot: kept"
    left.legend(loc="lower right", title=title, fontsize=8.5, title_fontsize=8.5)


def _draw_confusion(axes: Axes, fit: Fit, names: Sequence[str]) -> None:
    """Draw the confusion matrix of a classifier on held-out episodes."""
    count = fit.held_out.confusion.double().numpy()
    share = count / np.maximum(count.sum(1, keepdims=True), 1.0)
    axes.imshow(share, cmap="Blues", vmin=0.0, vmax=1.0)
    for (row, column), value in np.ndenumerate(share):
        colour, text = (
            "white" if value > 0.6 else "#222222",
            f"{value:.0%}\n{count[row, column]:.0f}",
        )
        axes.text(column, row, text, ha="center", va="center", fontsize=9, color=colour)
    axes.set(xlabel="predicted", ylabel="true flow")
    axes.set_xticks(range(len(names)), names)
    axes.set_yticks(range(len(names)), names)
