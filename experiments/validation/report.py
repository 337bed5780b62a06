"""What came out, as one page of Markdown with figures, and as JSON."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from math import inf, isfinite
from pathlib import Path
from typing import Any

import matplotlib as mpl

from experiments.figures import STYLE
from experiments.pages import write_table
from experiments.validation.case import MISSED, PASS, RECORDED, Check, as_range
from experiments.validation.runner import Outcome

HEADS = ("case", "quantity", "ours", "reference", "error", "tolerance", "verdict", "resolution")


def write_report(outcomes: Sequence[Outcome], *, page: Path, json_path: Path, command: str) -> None:
    """Write the page, a figure per case beside it and all checks as JSON.

    Args:
        outcomes: judged cases.
        page: Markdown file; the figures go into ``figures/validation`` beside it.
        json_path: the checks in a form that programs read.
        command: that the page was made by.
    """
    figures = page.parent / "figures" / "validation"
    figures.mkdir(parents=True, exist_ok=True)
    for outcome in outcomes:
        if outcome.figure is not None:
            with mpl.rc_context(STYLE):
                outcome.figure.savefig(figures / f"{outcome.case.name}.png")
    page.write_text(render(outcomes, command), encoding="utf-8")
    rows = [_to_row(outcome, check) for outcome in outcomes for check in outcome.checks]
    json_path.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


def _to_row(outcome: Outcome, check: Check) -> dict[str, Any]:
    row = {"case": outcome.case.name, **asdict(check)}
    row |= {"error": check.error, "verdict": check.verdict}
    plain: dict[str, Any] = json.loads(json.dumps(row), parse_constant=lambda _: None)
    return plain


def render(outcomes: Sequence[Outcome], command: str) -> str:
    """Return the page.

    Args:
        outcomes: judged cases.
        command: that the page was made by.
    """
    machines = {
        f"{m['cpu']}, {m['cores']} cores (each run on one), torch {m['torch']}, "
        f"Python {m['python']}"
        for outcome in outcomes
        for m in (record["machine"] for record in outcome.records.values())
    }
    minutes = ", ".join(f"{o.case.name} {o.seconds / 60:.1f}" for o in outcomes)
    total = sum(outcome.seconds for outcome in outcomes) / 60
    parts = [
        "# Validation",
        f"Made by `{command}`; every case beside its reference, missed criteria included.",
        f"Run on: {'; '.join(sorted(machines)) or 'nothing'}.",
        f"Minutes of one core: {minutes}; together {total:.1f}.",
        summarise(outcomes),
        render_table(outcomes),
        "Errors and tolerances are shares of the reference unless marked ±; of a range, the "
        "distance from its near end. *Recorded*: measured without an acceptance criterion.",
        *(part for outcome in outcomes for part in _render_case(outcome)),
    ]
    return "\n\n".join(part.strip() for part in parts) + "\n"


def summarise(outcomes: Sequence[Outcome]) -> str:
    """Return one sentence with the number of checks passed, missed and recorded."""
    verdicts = [check.verdict for outcome in outcomes for check in outcome.checks]
    missed = verdicts.count(MISSED)
    return (
        f"{verdicts.count(PASS)} checks pass, {f'**{missed} MISSED**' if missed else '0 missed'}, "
        f"{verdicts.count(RECORDED)} recorded without an acceptance criterion."
    )


def render_table(outcomes: Sequence[Outcome]) -> str:
    """Return the summary table, a row per check."""
    rows = [
        (
            outcome.case.name,
            check.quantity,
            format_number(check.ours),
            _format_reference(check),
            _format_error(check),
            _format_tolerance(check),
            f"**{MISSED}**" if check.verdict == MISSED else check.verdict,
            check.resolution or "–",
        )
        for outcome in outcomes
        for check in outcome.checks
    ]
    return write_table(HEADS, rows)


def _render_case(outcome: Outcome) -> list[str]:
    case = outcome.case
    parts = [f"## {case.title}", case.setup, f"Reference: {case.source}."]
    refined = [check for check in outcome.checks if check.refinement]
    for columns in dict.fromkeys(tuple(check.refinement) for check in refined):
        rows = [
            (check.quantity, *map(format_number, check.refinement.values()), reference)
            for check in refined
            if tuple(check.refinement) == columns and (reference := _format_reference(check))
        ]
        parts.append(write_table(("quantity", *columns, "reference"), rows))
    if outcome.figure is not None:
        parts.append(f"![{case.title}](figures/validation/{case.name}.png)")
    notes: dict[tuple[str, str], list[str]] = {}
    for check in outcome.checks:
        if check.note or check.verdict == MISSED:
            key = check.verdict, check.note or "reason not known."
            notes.setdefault(key, []).append(check.quantity)
    for (verdict, note), quantities in notes.items():
        mark = f"**{MISSED}**: " if verdict == MISSED else ""
        parts.append(f"{mark}{'; '.join(quantities)}: {note}")
    return parts


def format_number(value: float) -> str:
    """Return five digits; "–" where there is no number."""
    if not isfinite(value):
        return "–"
    return f"{value:.5g}" if value == 0 or 1e-3 <= abs(value) < 1e5 else f"{value:.2e}"


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
    if check.error is None:
        return "–"
    if check.error == 0.0 and isinstance(check.reference, tuple):
        return "inside"
    return _format_share(check.error, check.is_absolute)


def _format_tolerance(check: Check) -> str:
    if check.tolerance is not None:
        return _format_share(check.tolerance, check.is_absolute)
    return "inside" if isinstance(check.reference, tuple) else "–"
