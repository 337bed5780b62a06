"""The report: one page of Markdown with figures, and all checks as JSON."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from math import inf, isfinite
from pathlib import Path

import matplotlib as mpl

from experiments.pages import write_table
from experiments.validation.case import MISSED, PASS, RECORDED, Check, as_range
from experiments.validation.runner import FIGURE_STYLE, Outcome

HEADS = ("case", "quantity", "ours", "reference", "error", "tolerance", "verdict", "resolution")


def write_report(outcomes: Sequence[Outcome], *, page: Path, json_path: Path, command: str) -> None:
    """Write the page, its figures into ``figures/validation`` beside it and all checks as JSON.

    The page names the ``command`` that it was made by.
    """
    figures = page.parent / "figures" / "validation"
    figures.mkdir(parents=True, exist_ok=True)
    rows = []
    for outcome in outcomes:
        if outcome.figure is not None:
            with mpl.rc_context(FIGURE_STYLE):
                outcome.figure.savefig(figures / f"{outcome.case.name}.png")
        for check in outcome.checks:
            row = {"case": outcome.case.name, **asdict(check)}
            row |= {"error": check.error, "verdict": check.verdict}
            rows.append(json.loads(json.dumps(row), parse_constant=lambda _: None))
    page.write_text(render(outcomes, command), encoding="utf-8")
    json_path.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


def render(outcomes: Sequence[Outcome], command: str) -> str:
    """Return the page."""
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
    return write_table(
        HEADS, [_make_row(outcome.case.name, c) for outcome in outcomes for c in outcome.checks]
    )


def _make_row(case: str, check: Check) -> Sequence[str]:
    is_range = isinstance(check.reference, tuple)
    error = "inside" if is_range and check.error == 0.0 else _format_share(check, check.error)
    tolerance = _format_share(check, check.tolerance)
    if is_range and check.tolerance is None:
        tolerance = "inside"
    numbers = (format_number(check.ours), _format_reference(check), error, tolerance)
    verdict = f"**{MISSED}**" if check.verdict == MISSED else check.verdict
    return (case, check.quantity, *numbers, verdict, check.resolution or "–")


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
        mark = f"**{MISSED}**: " if check.verdict == MISSED else ""
        if note := check.note or (mark and "reason not known."):
            notes.setdefault((mark, note), []).append(check.quantity)
    return parts + [f"{mark}{'; '.join(names)}: {note}" for (mark, note), names in notes.items()]


def format_number(value: float) -> str:
    """Return five digits; "–" where there is no number."""
    if not isfinite(value):
        return "–"
    return f"{value:.5g}" if value == 0 or 1e-3 <= abs(value) < 1e5 else f"{value:.2e}"


def _format_reference(check: Check) -> str:
    if check.reference is None:
        return "–"
    low, high = as_range(check.reference)
    text = f"{format_number(low)} to {format_number(high)}"
    if low == high:
        text = format_number(low)
    elif high == inf:
        text = f"≥ {format_number(low)}"
    elif low in (0.0, -inf):
        text = f"≤ {format_number(high)}"
    return f"{text} ({check.source})" if check.source else text


def _format_share(check: Check, value: float | None) -> str:
    if value is None or not isfinite(value):
        return "–"
    return f"± {value:.2g}" if check.is_absolute else f"{100 * value:.2g} %"
