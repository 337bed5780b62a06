"""The results of a study as numbers, and as a page of tables beside the figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from experiments.lateral_line.questions import Answers
from experiments.lateral_line.study import Fit, Study
from experiments.pages import write_table


def describe(
    study: Study, fit: Fit, paper: Fit, tables: Mapping[str, Answers], *, num_splits: int
) -> dict[str, Any]:
    """Return the numbers of a study.

    Args:
        study: with the data.
        fit: of the classifier that is kept.
        paper: of the paper's.
        tables: accuracies, as ``answer`` returns.
        num_splits: divisions of the episodes behind each of them.
    """
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
        "num_splits": num_splits,
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


_PAGE = """# What the lateral line tells

Flows: {flows}; chance is {chance:.0%}. Accuracies are those on held-out episodes{divisions}.

Data: {samples} decisions in {episodes} episodes, half of the actions random and half of them
holding some station; {num_samples} samples per decision at {num_neuromasts} neuromasts. The row of
frequencies is drawn independently of the flow. All classifiers but the paper's are fitted on the
mirror image of each sample too.

{fits}
This classifier reads {features} over {window_T:.3g} T.

![accuracy and loss](curves.png)

![confusion matrix](confusion.png)

![window, noise, memory](limits.png)

## Memory

Predictions from all signals of the episode so far; memory 0 uses the current signal alone.

{memory}
## Window

{windows}
## Noise

Added to each feature, as a share of its standard deviation.

{noise}
## Leakage

*New starts*: those farthest downstream, none of them in the fit. *Later times*: decisions later in
their episodes than any in the fit.

{leaks}
## Own tail beat

After a wrong prediction a fish beats in the wrong flow's row. *Right row* fits use only data in the
row of the true label.

{rows}"""


def write_page(findings: Mapping[str, Any]) -> str:
    """Return the Markdown page of a study.

    Args:
        findings: as ``describe`` returns.
    """
    num_splits, sample_T = findings["num_splits"], findings["data"]["sample_T"]
    windows = {
        f"{int(length) * sample_T:.3g} T ({length})": values
        for length, values in findings["windows"]["accuracy"].items()
    }
    fits = {
        "this one": findings["classifier"],
        "as in the paper: [t, x, y, u_x, u_y, p, speed], mean, instant": findings["paper"],
    }
    divided = f", mean over {num_splits} divisions of the episodes [least-largest]"
    return _PAGE.format(
        flows=", ".join(flow["name"] for flow in findings["flows"]),
        chance=findings["chance"],
        divisions=divided if num_splits > 1 else "",
        **findings["data"],
        **{name: findings["sensors"][name] for name in ("num_samples", "num_neuromasts")},
        features=", ".join(findings["features"]),
        window_T=findings["window_T"],
        fits=write_table(
            ("classifier", "fitted", "held-out episodes", "samples", "epochs"),
            [
                (
                    name,
                    f"{fit['fitted_accuracy']:.1%}",
                    f"{fit['held_out_accuracy']:.1%}",
                    f"{fit['held_out_samples']} of {fit['held_out_episodes']} episodes",
                    f"{fit['chosen_epoch'] + 1} of {fit['epochs']}",
                )
                for name, fit in fits.items()
            ],
        ),
        memory=_tabulate("memory", findings["memory"]),
        windows=_tabulate("window (samples)", {"accuracy": windows}),
        noise=_tabulate("noise", findings["noise"]),
        leaks=_tabulate("input", findings["leaks"]),
        rows=_tabulate("classifier", findings["rows"]),
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
    mean = sum(known) / len(known)
    if len(known) == 1:
        return f"{mean:.1%}"
    return f"{mean:.1%} [{100 * min(known):.1f}-{100 * max(known):.1f}]"
