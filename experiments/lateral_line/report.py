"""The study in words: one page of tables beside the figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from experiments.lateral_line.findings import Answers


def write_page(findings: Mapping[str, Any]) -> str:
    """Return the Markdown page of a study.

    Args:
        findings: as in ``lateral_line.json``.
    """
    data, machine, paper = (findings[name] for name in ("data", "machine", "paper"))
    flows = ", ".join(flow["name"] for flow in findings["flows"])
    windows = {
        f"{int(length) * data['sample_T']:.3g} T ({length})": values
        for length, values in findings["windows"].items()
    }
    sensors = findings["sensors"]
    lines = [
        "# What the lateral line tells",
        "",
        f"Flows: {flows}; guessing is right in {findings['chance']:.0%}. Accuracies are those on "
        f"episodes that had no part in the fit{_name_divisions(findings['num_splits'])}.",
        "",
        f"Data: {data['samples']} decisions in {data['episodes']} episodes, actions half "
        "drawn at random and half to hold some station, "
        f"{sensors['num_samples']} samples per decision at {sensors['num_neuromasts']} "
        "neuromasts; the row of frequencies is drawn apart from the flow. "
        "But for the paper's, machines are fitted on the mirror image of each sample too.",
        "",
        "| machine | fitted | unseen episodes | samples | epochs |",
        "|---|---|---|---|---|",
        _row("this one", machine),
        _row("as in the paper: [t, x, y, u_x, u_y, p, speed], mean, instant", paper),
        "",
        f"This one reads {', '.join(findings['features'])} over {findings['window_T']:.3g} T.",
        "",
        "![accuracy and loss](curves.png)",
        "",
        "![who is taken for whom](confusion.png)",
        "",
        "![window, noise, memory](limits.png)",
        "",
        "## Memory",
        "",
        "The flow named by all that was felt so far in the episode; 0 is the present signal alone.",
        "",
        *_table("memory", {"accuracy": findings["memory"]["overall"]}),
        "",
        "## Window",
        "",
        *_table("window (samples)", {"accuracy": windows}),
        "",
        "## Noise",
        "",
        "Added to each feature, as a share of its standard deviation.",
        "",
        *_table("noise", findings["noise"]),
        "",
        "## Leaks",
        "",
        "*New starts*: those farthest downstream, never seen in the fit. *Later times*: decisions "
        "later in their episodes than any in the fit.",
        "",
        *_table("fed on", _turn(findings["leaks"])),
        "",
        "## Own tail beat",
        "",
        "A fish that takes the flow for another beats in the wrong row. *Right row* fits are those "
        "of data with the true label at hand.",
        "",
        *_table("machine", _turn(findings["confirmation"])),
        "",
    ]
    return "\n".join(lines)


def _name_divisions(num: int) -> str:
    return "" if num == 1 else f", mean over {num} divisions of the episodes [least-largest]"


def _row(name: str, fit: Mapping[str, Any]) -> str:
    return (
        f"| {name} | {fit['fitted_accuracy']:.1%} | {fit['held_out_accuracy']:.1%} "
        f"| {fit['held_out_samples']} of {fit['held_out_episodes']} episodes "
        f"| {fit['chosen_epoch'] + 1} of {fit['epochs']} |"
    )


def _turn(answers: Mapping[str, Answers]) -> dict[str, Answers]:
    """Make rows columns."""
    columns: dict[str, Answers] = {}
    for row, cells in answers.items():
        for column, values in cells.items():
            columns.setdefault(column, {})[row] = values
    return columns


def _table(corner: str, columns: Mapping[str, Answers]) -> list[str]:
    rows = next(iter(columns.values()))
    lines = [f"| {corner} | {' | '.join(columns)} |", "|---" * (len(columns) + 1) + "|"]
    for row in rows:
        cells = [format_accuracies(column[row]) for column in columns.values()]
        lines.append(f"| {row} | {' | '.join(cells)} |")
    return lines


def format_accuracies(values: Sequence[float]) -> str:
    """Write mean and range, such as ``91.0% [88.1-93.2]``."""
    known = [value for value in values if value == value]
    if not known:
        return "-"
    mean = sum(known) / len(known)
    if len(known) == 1:
        return f"{mean:.1%}"
    return f"{mean:.1%} [{100 * min(known):.1f}-{100 * max(known):.1f}]"
