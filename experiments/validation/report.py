"""The report: a page of verdicts, a page of Markdown for each case, and all checks as JSON."""

import re
from collections.abc import Sequence
from dataclasses import asdict, replace
from math import inf, isfinite
from pathlib import Path

import matplotlib as mpl

from experiments.validation.case import MISSED, PASS, RECORDED, Check, as_range
from experiments.validation.runner import FIGURE_STYLE, Outcome
from fishrl.files import staged, write_whole
from fishrl.pages import write_table
from fishrl.training.run_folder import write_json

HEADS = ("quantity", "ours", "reference", "error", "tolerance", "verdict", "resolution")
SUMMARY = ("case", "quantity", "ours", "reference", "deviation", "tolerance", "verdict", "met")
NUM_DEVIATIONS = 2  # named at the top of the page
LONGEST_SOURCE = 40  # characters in the table of verdicts; the cases' own pages have all
INTRODUCTION = """\
The flow solver and the swimming fish, compared with exact solutions, other codes and experiments.
The table has one quantity of each case; its link leads to all quantities, figures and set-up."""
EXPLANATION = """\
*Deviation* and *tolerance* are relative to the reference unless marked ±; from a range they are
measured to its nearer end. *Met* counts the criteria of the case that are met; *recorded*
quantities have none."""


def write_report(outcomes: Sequence[Outcome], *, page: Path, json_path: Path, command: str) -> None:
    """Write the page of verdicts, the cases' own pages, their figures, and all checks as JSON.

    In the folder of ``page``, the cases' pages go into ``validation`` and figures into
    ``figures/validation``. The page names the ``command`` that made it.
    """
    figures, cases = page.parent / "figures" / "validation", page.parent / "validation"
    for folder in (figures, cases):
        folder.mkdir(parents=True, exist_ok=True)
    for outcome in outcomes:
        name = outcome.case.name
        if outcome.figure is not None:
            with mpl.rc_context(FIGURE_STYLE), staged(figures / f"{name}.png") as stage:
                outcome.figure.savefig(stage)
        write_whole(cases / f"{name}.md", render_case(outcome))
    write_whole(page, render(outcomes, command))
    rows = [
        {"case": outcome.case.name, **asdict(check), "error": check.error, "verdict": check.verdict}
        for outcome in outcomes
        for check in outcome.checks
    ]
    write_json(json_path, rows)


def render(outcomes: Sequence[Outcome], command: str) -> str:
    """Return the page of verdicts."""
    form = "{cpu}, {cores} cores (each run on one), torch {torch}, Python {python}"
    records = [record for outcome in outcomes for record in outcome.records.values()]
    machines = {form.format(**record["machine"]) for record in records}
    minutes = sum(record["seconds"] for record in records) / 60
    misses = [
        _describe(outcome, check, default="Reason not known.")
        for outcome in outcomes
        for check in outcome.checks
        if check.verdict == MISSED
    ]
    deviations = [
        (check.error, _describe(outcome, check))
        for outcome in outcomes
        for check in find_headline(outcome)
        if not check.is_absolute and check.error and isfinite(check.error)
    ]
    largest = [line for _, line in sorted(deviations, reverse=True)[:NUM_DEVIATIONS]]
    pages = "\n".join(f"validation/{outcome.case.name}" for outcome in outcomes)
    parts = [
        "# Validation",
        INTRODUCTION.replace("\n", " "),
        f"```sh\n{command}\n```",
        summarise(outcomes),
        _list("Missed criteria", misses),
        _list("Largest deviations in the table", largest),
        render_summary(outcomes),
        EXPLANATION.replace("\n", " "),
        f"Run on {'; '.join(sorted(machines)) or 'nothing'}; {minutes:.0f} minutes of CPU time.",
        f"```{{toctree}}\n:hidden:\n\n{pages}\n```",
    ]
    return _join(parts)


def _join(parts: Sequence[str]) -> str:
    return "\n\n".join(part.strip() for part in parts if part) + "\n"


def _link(outcome: Outcome) -> str:
    return f"[{outcome.case.title}](validation/{outcome.case.name}.md)"


def _list(title: str, lines: Sequence[str]) -> str:
    return "\n".join([f"**{title}**\n", *(f"- {line}" for line in lines)]) if lines else ""


def _describe(outcome: Outcome, check: Check, *, default: str = "") -> str:
    """Return a check in one line, with the first sentence of its note."""
    _, ours, reference, error, *_ = _make_row(check)
    note = re.split(r"(?<=\w[\w)])\. (?=[A-Z])", check.note)[0].removesuffix(".")
    note = f"{note[:1].upper()}{note[1:]}." if note else default
    numbers = f"{ours}, reference {reference}, deviation {error}."
    return f"{_link(outcome)}, {check.quantity}: {numbers} {note}".strip()


def summarise(outcomes: Sequence[Outcome]) -> str:
    """Return one sentence with the number of checks passed, missed and recorded."""
    verdicts = [check.verdict for outcome in outcomes for check in outcome.checks]
    missed = verdicts.count(MISSED)
    return (
        f"{verdicts.count(PASS)} checks pass, {f'**{missed} MISSED**' if missed else '0 missed'}, "
        f"{verdicts.count(RECORDED)} recorded without an acceptance criterion."
    )


def render_summary(outcomes: Sequence[Outcome]) -> str:
    """Return the table of verdicts: a row per case, with its headline quantity."""
    rows = []
    for outcome in outcomes:
        for headline in find_headline(outcome):
            verdicts = [check.verdict for check in outcome.checks]
            met, missed = verdicts.count(PASS), verdicts.count(MISSED)
            criteria = f"{met} of {met + missed}" if met + missed else "–"
            short = headline.source if len(headline.source) <= LONGEST_SOURCE else ""
            row = _make_row(replace(headline, source=short))
            rows.append((_link(outcome), *row[:-1], criteria))
    return write_table(SUMMARY, rows, has_links=True)


def find_headline(outcome: Outcome) -> Sequence[Check]:
    """Return the check that stands for a case in the table of verdicts, if there is any."""
    named = [check for check in outcome.checks if check.quantity == outcome.case.headline]
    return (named or outcome.checks)[:1]


def render_table(outcomes: Sequence[Outcome]) -> str:
    """Return a row for each check, with the name of its case."""
    rows = [(outcome.case.name, *_make_row(c)) for outcome in outcomes for c in outcome.checks]
    return write_table(("case", *HEADS), rows)


def _make_row(check: Check) -> Sequence[str]:
    is_range = isinstance(check.reference, tuple)
    error = "inside" if is_range and check.error == 0.0 else _format_share(check, check.error)
    is_inside = is_range and check.tolerance is None
    tolerance = "inside" if is_inside else _format_share(check, check.tolerance)
    numbers = (format_number(check.ours), _format_reference(check), error, tolerance)
    verdict = f"**{MISSED}**" if check.verdict == MISSED else check.verdict
    return (check.quantity, *numbers, verdict, check.resolution or "–")


def render_case(outcome: Outcome) -> str:
    """Return the page of one case."""
    case = outcome.case
    parts = [
        f"# {case.title}",
        case.setup,
        f"Reference: {case.source}. Back to [all cases](../validation.md).",
    ]
    if outcome.figure is not None:
        parts.append(f"![{case.title}](../figures/validation/{case.name}.png)")
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
    parts.append(f"CPU time: {outcome.seconds / 60:.1f} minutes on one core.")
    return _join(parts)


def _render_refinement(checks: Sequence[Check]) -> list[str]:
    """Return a table for each set of runs: quantities by run."""
    tables: dict[tuple[str, ...], list[Sequence[str]]] = {}
    for check in checks:
        if runs := tuple(check.refinement):
            row = (check.quantity, *map(format_number, check.refinement.values()))
            tables.setdefault(runs, []).append(row)
    return [write_table(("quantity", *runs), rows) for runs, rows in tables.items()]


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
