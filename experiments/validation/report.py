"""What came out, as one page of Markdown with figures, and as JSON."""

from __future__ import annotations

import json
from collections.abc import Sequence
from math import inf, isfinite
from pathlib import Path
from typing import Any

import matplotlib as mpl

from experiments.figures import STYLE
from experiments.validation.case import MISSED, Check, as_range
from experiments.validation.runner import Outcome, write_whole

HEADER = "| case | quantity | ours | reference | error | tolerance | verdict | resolution |"


def write_report(
    outcomes: Sequence[Outcome], *, page: Path, figures: Path, json_path: Path, command: str
) -> None:
    """Write the page, a figure per case and all checks as JSON.

    Args:
        outcomes: judged cases.
        page: Markdown file.
        figures: folder of the PNGs, below the page's own.
        json_path: the checks in a form that programs read.
        command: that the page was made by.
    """
    figures.mkdir(parents=True, exist_ok=True)
    for outcome in outcomes:
        if outcome.figure is not None:
            with mpl.rc_context(STYLE):
                outcome.figure.savefig(figures / f"{outcome.case.name}.png")
    folder = figures.relative_to(page.parent).as_posix()
    write_whole(page, render(outcomes, figures=folder, command=command))
    rows = [_plain(outcome, check) for outcome in outcomes for check in outcome.checks]
    write_whole(json_path, json.dumps(rows, indent=1) + "\n")


def render(outcomes: Sequence[Outcome], *, figures: str, command: str) -> str:
    """Return the page.

    Args:
        outcomes: judged cases.
        figures: folder of the PNGs as seen from the page.
        command: that the page was made by.
    """
    lines = [
        "# Validation",
        "",
        f"Made by `{command}`; every case beside its reference, missed bars included.",
        "",
        *describe_run(outcomes),
        "",
        summarise(outcomes),
        "",
        *render_table(outcomes),
        "",
        "Errors and tolerances are shares of the reference unless marked ±; of a range, the "
        "distance from its near end. *Recorded*: measured beside no bar.",
    ]
    for outcome in outcomes:
        lines += ["", *_render_case(outcome, figures)]
    return "\n".join(lines) + "\n"


def summarise(outcomes: Sequence[Outcome]) -> str:
    """Return one sentence with the number of checks passed, missed and recorded."""
    verdicts = [check.verdict for outcome in outcomes for check in outcome.checks]
    missed = verdicts.count(MISSED)
    return (
        f"{verdicts.count('pass')} checks pass, "
        f"{f'**{missed} MISSED**' if missed else '0 missed'}, "
        f"{verdicts.count('recorded')} recorded without a bar."
    )


def describe_run(outcomes: Sequence[Outcome]) -> list[str]:
    """Return what the results were computed on and how long each case took."""
    machines = {
        f"{m['cpu']}, {m['cores']} cores (each run on one), torch {m['torch']}, "
        f"Python {m['python']}"
        for outcome in outcomes
        for m in (record["machine"] for record in outcome.records.values())
    }
    minutes = ", ".join(f"{o.case.name} {o.seconds / 60:.1f}" for o in outcomes)
    total = sum(outcome.seconds for outcome in outcomes) / 60
    return [
        f"Run on: {'; '.join(sorted(machines)) or 'nothing'}.",
        "",
        f"Minutes of one core: {minutes}; together {total:.1f}.",
    ]


def render_table(outcomes: Sequence[Outcome]) -> list[str]:
    """Return the summary table, a row per check."""
    rows = [HEADER, "|---" * (HEADER.count("|") - 1) + "|"]
    for outcome in outcomes:
        for check in outcome.checks:
            verdict = f"**{MISSED}**" if check.verdict == MISSED else check.verdict
            cells = [
                outcome.case.name,
                check.quantity,
                format_number(check.ours),
                _format_reference(check),
                _format_error(check),
                _format_tolerance(check),
                verdict,
                check.resolution or "–",
            ]
            rows.append("| " + " | ".join(_escape(cell) for cell in cells) + " |")
    return rows


def format_number(value: float) -> str:
    """Return five digits; "–" where there is no number."""
    if not isfinite(value):
        return "–"
    return f"{value:.5g}" if value == 0 or 1e-3 <= abs(value) < 1e5 else f"{value:.2e}"


def _escape(cell: str) -> str:
    return cell.replace("|", "\\|").replace("\n", " ")


def _format_reference(check: Check) -> str:
    if check.reference is None:
        return "–"
    low, high = as_range(check.reference)
    if low == high:
        text = format_number(low)
    elif high == inf:
        text = f"≥ {format_number(low)}"
    elif low in (0.0, -inf):
        text = f"≤ {format_number(high)}"
    else:
        text = f"{format_number(low)} to {format_number(high)}"
    return f"{text} ({check.source})" if check.source else text


def _format_share(value: float, is_absolute: bool) -> str:
    if not isfinite(value):
        return "–"
    return f"± {value:.2g}" if is_absolute else f"{100 * value:.2g} %"


def _format_error(check: Check) -> str:
    if check.error is None or (check.error == 0.0 and isinstance(check.reference, tuple)):
        return "–" if check.error is None else "inside"
    return _format_share(check.error, check.is_absolute)


def _format_tolerance(check: Check) -> str:
    if check.tolerance is not None:
        return _format_share(check.tolerance, check.is_absolute)
    return "inside" if isinstance(check.reference, tuple) else "–"


def _render_case(outcome: Outcome, figures: str) -> list[str]:
    case = outcome.case
    lines = [f"## {case.title}", "", case.setup, "", f"Reference: {case.source}."]
    if refined := [check for check in outcome.checks if check.refinement]:
        lines += ["", *_render_refinement(refined)]
    if outcome.figure is not None:
        lines += ["", f"![{case.title}]({figures}/{case.name}.png)"]
    notes: dict[tuple[str, str], list[str]] = {}
    for check in outcome.checks:
        if check.note or check.verdict == MISSED:
            note = check.note or "reason not known."
            notes.setdefault((check.verdict, note), []).append(check.quantity)
    for (verdict, note), quantities in notes.items():
        mark = f"**{MISSED}**: " if verdict == MISSED else ""
        lines += ["", f"{mark}{'; '.join(quantities)}: {note}"]
    return lines


def _render_refinement(checks: Sequence[Check]) -> list[str]:
    """Return a table per set of resolutions, a row per quantity."""
    lines: list[str] = []
    for columns in dict.fromkeys(tuple(check.refinement) for check in checks):
        lines += ["", f"| quantity | {' | '.join(columns)} | reference |"]
        lines += ["|---" * (len(columns) + 2) + "|"]
        for check in checks:
            if tuple(check.refinement) == columns:
                cells = [
                    check.quantity,
                    *(format_number(value) for value in check.refinement.values()),
                    _format_reference(check),
                ]
                lines.append("| " + " | ".join(_escape(cell) for cell in cells) + " |")
    return lines[1:]


def _plain(outcome: Outcome, check: Check) -> dict[str, Any]:
    ends = None if check.reference is None else [_number(x) for x in as_range(check.reference)]
    return {
        "case": outcome.case.name,
        "quantity": check.quantity,
        "ours": _number(check.ours),
        "reference": ends,
        "source": check.source,
        "error": None if check.error is None else _number(check.error),
        "tolerance": check.tolerance,
        "is_absolute": check.is_absolute,
        "verdict": check.verdict,
        "resolution": check.resolution,
        "refinement": {name: _number(value) for name, value in check.refinement.items()},
        "note": check.note,
    }


def _number(value: float) -> float | None:
    return value if isfinite(value) else None
