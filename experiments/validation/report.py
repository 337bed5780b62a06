"""The report: each case's results as JSON and a figure, and the pages that are made from them."""

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from math import inf, isfinite
from pathlib import Path
from typing import Any

import matplotlib as mpl

from experiments.validation.case import MISSED, PASS, RECORDED, Case, Check
from experiments.validation.runner import FIGURE_STYLE, Outcome
from fishrl.files import staged, write_whole
from fishrl.pages import write_table
from fishrl.training.run_folder import write_json

#: A check as it is stored: the fields of ``Check`` with ``error`` and ``verdict``.
Row = dict[str, Any]
#: A case and its stored results.
Result = tuple[Case, Mapping[str, Any]]

HEADS = ("quantity", "ours", "reference", "error", "tolerance", "verdict", "resolution")
#: Where the first sentence of a note ends; "2.5" and "e.g." end none.
FIRST_SENTENCE = re.compile(r"(?<=\w[\w)]\.) (?=[A-Z])")
SUMMARY = ("case", "quantity", "ours", "accepted", "verdict")
INTRODUCTION = """\
How closely the flow solver and the swimming fish agree with exact solutions, other codes and
experiments: every acceptance criterion with its result, and what is known of each miss. Links lead
to a case's page on the site, to its numbers in the repository. All cases take three hours of CPU,
`make validate-quick` minutes."""
EXPLANATION = """\
*Accepted* is a range, or a reference with its tolerance. A miss gives its deviation from that,
relative unless marked ±. *Recorded* quantities have no criterion; one here stands for its case."""


def write_report(outcomes: Sequence[Outcome], *, folder: Path, command: str, commit: str) -> None:
    """Write ``validation.md``, and the results and the figure of each case.

    Results go into ``folder/validation``, figures into ``folder/figures/validation``. The page
    names the ``command`` that made it, the results the ``commit`` at which they were measured.
    """
    figures = folder / "figures" / "validation"
    for path in (figures, folder / "validation"):
        path.mkdir(parents=True, exist_ok=True)
    for outcome in outcomes:
        name = outcome.case.name
        if outcome.figure is not None:
            with mpl.rc_context(FIGURE_STYLE), staged(figures / f"{name}.png") as stage:
                outcome.figure.savefig(stage)
        write_json(folder / "validation" / f"{name}.json", store(outcome, commit))
    results = read_results([outcome.case for outcome in outcomes], folder)
    write_whole(folder / "validation.md", render(results, command))


def store(outcome: Outcome, commit: str) -> dict[str, Any]:
    """Return the results of a case as they are stored, without its figure."""
    form = "{cpu}, {cores} cores (each run on one), torch {torch}, Python {python}"
    machines = {form.format(**record["machine"]) for record in outcome.records.values()}
    head = {"commit": commit, "machines": sorted(machines), "minutes": outcome.seconds / 60}
    return {**head, "checks": list_rows(outcome.checks)}


def list_rows(checks: Iterable[Check]) -> list[Row]:
    """Return checks as they are stored."""
    return [asdict(c) | {"error": c.error, "verdict": c.verdict} for c in checks]


def read_results(cases: Iterable[Case], folder: Path) -> list[Result]:
    """Return the stored results of cases; a missing file is an error."""
    paths = [(case, folder / "validation" / f"{case.name}.json") for case in cases]
    return [(case, json.loads(path.read_text(encoding="utf-8"))) for case, path in paths]


def render(results: Sequence[Result], command: str) -> str:
    """Return the page with all criteria."""
    rows = [row for _, stored in results for row in stored["checks"]]
    machines = sorted({machine for _, stored in results for machine in stored["machines"]})
    commits = ", ".join(dict.fromkeys(stored["commit"] for _, stored in results))
    minutes = sum(stored["minutes"] for _, stored in results)
    pages = "\n".join(f"validation/{case.name}" for case, _ in results)
    run = f"Run at commit {commits} on {'; '.join(machines) or 'nothing'}; {minutes:.0f} minutes"
    return _join(
        "# Validation",
        INTRODUCTION.replace("\n", " "),
        f"```sh\n{command}\n```",
        summarise(rows),
        _render_criteria(results),
        EXPLANATION.replace("\n", " "),
        f"## Missed criteria\n\n{misses}" if (misses := _render_misses(results)) else "",
        f"{run} of CPU time.",
        f"```{{toctree}}\n:hidden:\n\n{pages}\n```",
    )


def summarise(rows: Sequence[Row]) -> str:
    """Return one sentence with the number of checks passed, missed and recorded."""
    verdicts = [row["verdict"] for row in rows]
    missed = verdicts.count(MISSED)
    return (
        f"{verdicts.count(PASS)} checks pass, {f'**{missed} MISSED**' if missed else '0 missed'}, "
        f"{verdicts.count(RECORDED)} recorded without an acceptance criterion."
    )


def _render_criteria(results: Sequence[Result]) -> str:
    """Return the table of all criteria, and of the quantities that stand for their case."""
    table = []
    for case, stored in results:
        rows = stored["checks"]
        headline = next((r for r in rows if r["quantity"] == case.headline), rows[0])
        shown = [row for row in rows if row is headline or row["verdict"] != RECORDED]
        links = [_link(case), *[""] * (len(shown) - 1)]
        for link, row in zip(links, shown, strict=True):
            quantity, ours, reference, error, tolerance, verdict, _ = _format(row)
            accepted = f"{reference} ± {tolerance.removeprefix('± ')}"
            if tolerance in ("–", "inside"):
                accepted = reference
            by = f", {error}" if row["verdict"] == MISSED else ""
            table.append((link, quantity, ours, accepted, verdict + by))
    return write_table(SUMMARY, table)


def _render_misses(results: Sequence[Result]) -> str:
    lines = []
    for case, stored in results:
        missed = [row for row in stored["checks"] if row["verdict"] == MISSED]
        short = [row | {"note": FIRST_SENTENCE.split(row["note"])[0]} for row in missed]
        reasons = _group_by_note(short)
        if reasons:
            shown = [f"{names}: {note}" for (_, note), names in reasons.items()]
            lines.append(f"- {_link(case)}, {' '.join(shown)}")
    return "\n".join(lines)


def _link(case: Case) -> str:
    return f"[{case.title}](validation/{case.name}.json)"


def _group_by_note(rows: Iterable[Row]) -> dict[tuple[bool, str], str]:
    """Return the quantities of each note, by whether their criterion is missed and by the note."""
    found: dict[tuple[bool, str], list[str]] = {}
    for row in rows:
        is_missed = row["verdict"] == MISSED
        if note := row["note"] or (is_missed and "reason not known."):
            found.setdefault((is_missed, note), []).append(row["quantity"])
    return {key: f"*{'; '.join(names)}*" for key, names in found.items()}


def render_checks(outcomes: Sequence[Outcome]) -> str:
    """Return a row for each check, with the name of its case."""
    rows = [(o.case.name, *_format(row)) for o in outcomes for row in list_rows(o.checks)]
    return write_table(("case", *HEADS), rows)


def render_case(case: Case, stored: Mapping[str, Any]) -> str:
    """Return the page of one case."""
    rows = stored["checks"]
    table = [_format(row, has_source=True) for row in rows]
    lines = [
        f"- {f'**{MISSED}**: ' if is_missed else ''}{names}: {note}"
        for (is_missed, note), names in _group_by_note(rows).items()
    ]
    fold = "<details>\n<summary>Values of all runs</summary>"
    refinement = _render_refinement(rows)
    commit, minutes = stored["commit"], stored["minutes"]
    return _join(
        f"# {case.title}",
        case.setup,
        f"Reference: {case.source}. Back to [all cases](../validation.md).",
        f"![{case.title}](../figures/validation/{case.name}.png)",
        write_table(HEADS, table),
        "\n".join(lines),
        *([fold, *refinement, "</details>"] if refinement else []),
        f"CPU time: {minutes:.1f} minutes on one core. Measured at commit {commit}.",
    )


def _join(*parts: str) -> str:
    return "\n\n".join(part.strip() for part in parts if part) + "\n"


def _render_refinement(rows: Sequence[Row]) -> list[str]:
    """Return a table for each set of runs: quantities by run."""
    tables: dict[tuple[str, ...], list[Sequence[str]]] = {}
    for row in rows:
        if runs := tuple(row["refinement"]):
            values = map(format_number, row["refinement"].values())
            tables.setdefault(runs, []).append((row["quantity"], *values))
    return [write_table(("quantity", *runs), rows) for runs, rows in tables.items()]


def _format(row: Row, *, has_source: bool = False) -> Sequence[str]:
    """Return the cells of a check, by ``HEADS``."""
    is_range = isinstance(row["reference"], list | tuple)
    error = "inside" if is_range and row["error"] == 0.0 else _format_share(row, row["error"])
    is_inside = is_range and row["tolerance"] is None
    tolerance = "inside" if is_inside else _format_share(row, row["tolerance"])
    reference = _format_reference(row["reference"])
    if has_source and row["source"]:
        reference += f" ({row['source']})"
    verdict = f"**{MISSED}**" if row["verdict"] == MISSED else row["verdict"]
    numbers = (format_number(row["ours"]), reference, error, tolerance)
    return (row["quantity"], *numbers, verdict, row["resolution"] or "–")


def format_number(value: float | None) -> str:
    """Return five digits; "–" where there is no number."""
    if value is None or not isfinite(value):
        return "–"
    return f"{value:.5g}" if value == 0 or 1e-3 <= abs(value) < 1e5 else f"{value:.2e}"


def _format_reference(reference: Any) -> str:
    if not isinstance(reference, list | tuple):
        return format_number(reference)
    low, high = reference
    if low == high:
        return format_number(low)
    if high in (None, inf):
        return f"≥ {format_number(low)}"
    if low in (None, -inf, 0.0):
        return f"≤ {format_number(high)}"
    return f"{format_number(low)} to {format_number(high)}"


def _format_share(row: Row, value: float | None) -> str:
    if value is None or not isfinite(value):
        return "–"
    return f"± {value:.2g}" if row["is_absolute"] else f"{100 * value:.2g} %"
