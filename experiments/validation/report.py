"""The report: one page of Markdown with figures, and all checks as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from math import inf, isfinite
from pathlib import Path

import matplotlib as mpl

from experiments.validation.case import MISSED, PASS, RECORDED, Check, as_range
from experiments.validation.runner import FIGURE_STYLE, Outcome
from fishrl.programs.pages import write_table
from fishrl.training.run_folder import write_json

HEADS = ("quantity", "ours", "reference", "error", "tolerance", "verdict", "resolution")
SUMMARY = ("case", "quantity", "ours", "literature", "deviation", "verdict", "all criteria")
LONGEST_SOURCE = 40  # characters in the summary table; the tables below have all
INTRODUCTION = """\
The flow solver and the swimming fish, compared with exact solutions, other codes and experiments.
The summary table has one quantity of each case; the sections below have all quantities, missed
criteria included."""


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
            derived = {"error": check.error, "verdict": check.verdict}
            rows.append({"case": outcome.case.name, **asdict(check), **derived})
    page.write_text(render(outcomes, command), encoding="utf-8")
    write_json(json_path, rows)


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
        INTRODUCTION.replace("\n", " "),
        f"```sh\n{command}\n```",
        render_summary(outcomes),
        summarise(outcomes),
        "Errors, deviations and tolerances are relative to the reference unless marked ±; for a "
        "range, they are measured from its nearer end. *Recorded* quantities have no acceptance "
        "criterion.",
        f"Run on {'; '.join(sorted(machines)) or 'nothing'}. CPU time on one core, in minutes: "
        f"{minutes}; {total:.1f} in total.",
        *(part for outcome in outcomes for part in _render_case(outcome)),
    ]
    return "\n\n".join(part.strip() for part in parts if part) + "\n"


def summarise(outcomes: Sequence[Outcome]) -> str:
    """Return one sentence with the number of checks passed, missed and recorded."""
    verdicts = [check.verdict for outcome in outcomes for check in outcome.checks]
    missed = verdicts.count(MISSED)
    return (
        f"{verdicts.count(PASS)} checks pass, {f'**{missed} MISSED**' if missed else '0 missed'}, "
        f"{verdicts.count(RECORDED)} recorded without an acceptance criterion."
    )


def render_summary(outcomes: Sequence[Outcome]) -> str:
    """Return the summary table: a row per case, with its headline quantity."""
    return write_table(SUMMARY, [_summarise_case(o) for o in outcomes if o.checks])


def render_table(outcomes: Sequence[Outcome]) -> str:
    """Return a row for each check, with the name of its case."""
    rows = [(outcome.case.name, *_make_row(c)) for outcome in outcomes for c in outcome.checks]
    return write_table(("case", *HEADS), rows)


def _summarise_case(outcome: Outcome) -> Sequence[str]:
    named = [check for check in outcome.checks if check.quantity == outcome.case.headline]
    quantity, ours, reference, error, _, verdict, _ = _make_row((named or outcome.checks)[0])
    literature, _, source = reference.partition(" (")
    if len(source) <= LONGEST_SOURCE:
        literature = reference
    verdicts = [check.verdict for check in outcome.checks]
    met, missed = verdicts.count(PASS), verdicts.count(MISSED)
    criteria = f"{met} of {met + missed} met" if met + missed else "none"
    link = f"[{outcome.case.title}](#{make_anchor(outcome.case.title)})"
    return (link, quantity, ours, literature, error, verdict, criteria)


def make_anchor(heading: str) -> str:
    """Return the anchor that Markdown gives a heading."""
    return "".join(c for c in heading.lower() if c.isalnum() or c in " -_").replace(" ", "-")


def _make_row(check: Check) -> Sequence[str]:
    is_range = isinstance(check.reference, tuple)
    error = "inside" if is_range and check.error == 0.0 else _format_share(check, check.error)
    tolerance = _format_share(check, check.tolerance)
    if is_range and check.tolerance is None:
        tolerance = "inside"
    numbers = (format_number(check.ours), _format_reference(check), error, tolerance)
    verdict = f"**{MISSED}**" if check.verdict == MISSED else check.verdict
    return (check.quantity, *numbers, verdict, check.resolution or "–")


def _render_case(outcome: Outcome) -> list[str]:
    case = outcome.case
    parts = [f"## {case.title}", case.setup, f"Reference: {case.source}."]
    if outcome.figure is not None:
        parts.append(f"![{case.title}](figures/validation/{case.name}.png)")
    parts.append(write_table(HEADS, [_make_row(check) for check in outcome.checks]))
    notes: dict[tuple[str, str], list[str]] = {}
    for check in outcome.checks:
        mark = f"**{MISSED}**: " if check.verdict == MISSED else ""
        if note := check.note or (mark and "reason not known."):
            notes.setdefault((mark, note), []).append(check.quantity)
    listed = [f"- {mark}*{'; '.join(names)}*: {note}" for (mark, note), names in notes.items()]
    parts.append("\n".join(listed))
    if tables := _render_refinement(outcome.checks):
        fold = "<details>\n<summary>Values of all runs</summary>"
        parts += [fold, *tables, "</details>"]
    return parts


def _render_refinement(checks: Sequence[Check]) -> list[str]:
    """Return a table for each set of runs: quantities by run."""
    refined = [check for check in checks if check.refinement]
    tables = []
    for columns in dict.fromkeys(tuple(check.refinement) for check in refined):
        rows = [
            (check.quantity, *map(format_number, check.refinement.values()))
            for check in refined
            if tuple(check.refinement) == columns
        ]
        tables.append(write_table(("quantity", *columns), rows))
    return tables


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
