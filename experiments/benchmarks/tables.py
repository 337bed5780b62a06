"""What was measured, as tables: plain for the terminal, Markdown for the page."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from experiments.benchmarks.entry import FISH
from experiments.benchmarks.goals import MISSED, Verdict, judge
from experiments.benchmarks.results import Results, Row, Spread, compare, compare_times, spread

SPEED_GROUPS = ("probe", "solver", "coupled", "peers", "gpu")


class Table(NamedTuple):
    """A heading, a line above the table, and its cells, the header first."""

    title: str
    note: str
    cells: list[list[str]]


def list_tables(results: Results) -> list[Table]:
    """Return every table that there is something to put into."""
    tables = [
        _tabulate_goals(judge(results)),
        *(_tabulate_speed(results, group) for group in SPEED_GROUPS),
        _tabulate_solves(results),
        _tabulate_scaling(results),
        _tabulate_actions(results),
        _tabulate_training(results),
        _tabulate_profile(results),
        _tabulate_studies(results),
        _tabulate_cuda(results),
    ]
    return [table for table in tables if len(table.cells) > 1]


def render_plain(table: Table) -> str:
    """Return a table for the terminal."""
    widths = [max(len(row[i]) for row in table.cells) for i in range(len(table.cells[0]))]
    lines = [table.title]
    for row in table.cells:
        cells = [row[0].ljust(widths[0])]
        cells += [cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True)]
        lines.append("  " + "  ".join(cells).rstrip())
    return "\n".join(lines)


def render_markdown(table: Table) -> str:
    """Return a table for the page, under a heading of its own."""
    header, *rows = table.cells
    lines = ["| " + " | ".join(header) + " |", "|---" * len(header) + "|"]
    lines += ["| " + " | ".join(row) + " |" for row in rows]
    note = [table.note, ""] if table.note else []
    return "\n".join([f"### {table.title}", "", *note, *lines])


def format_spread(values: Spread, digits: int = 2) -> str:
    """Return median and quartiles, such as "1.80 [1.79, 1.81]"; one number where they agree."""
    median = f"{values.median:.{digits}f}"
    if values.low == values.high:
        return median
    return f"{median} [{values.low:.{digits}f}, {values.high:.{digits}f}]"


def _tabulate_goals(verdicts: Sequence[Verdict]) -> Table:
    cells = [["goal", "bar", "measured", "verdict"]]
    for verdict in verdicts:
        goal = verdict.goal
        word = verdict.word.upper() if verdict.word == MISSED else verdict.word
        found = "–" if verdict.found is None else f"{format_spread(verdict.found)} {goal.unit}"
        sign = "≥" if goal.is_floor else "≤"
        cells.append([goal.what, f"{sign} {goal.bar:g} {goal.unit}", found, word])
    return Table("Goals", "Ratios of the same round: median and quartiles.", cells)


def _tabulate_speed(results: Results, group: str) -> Table:
    probes = [results.find(f"probe/{name}") for name in ("copy", "in place")]
    cells = [
        ["case", "code", "what", "MLUPS", "/ copy", "/ in-place probe", "B / update", "MB"],
    ]
    for row in results.of_group(group):
        if not row.label.startswith("solve/"):
            low, median, high = row.mlups
            cells.append(
                [
                    row.name,
                    row.code,
                    row.scope,
                    f"{median:.0f} [{low:.0f}, {high:.0f}]",
                    *(_format_ratio(row, probe) for probe in probes),
                    str(row.bytes_per_update),
                    f"{row.working_set / 1e6:.1f}",
                ]
            )
    titles = {
        "probe": "What the memory does",
        "solver": "The flow",
        "coupled": "A swimming fish in each flow",
        "peers": "Other codes",
        "gpu": "GPU",
    }
    return Table(titles[group], "", cells)


def _format_ratio(row: Row, probe: Row | None) -> str:
    return "–" if probe is None else f"{compare(row, probe).median:.2f}"


def _tabulate_solves(results: Results) -> Table:
    rows = [row for row in results.rows if row.label.startswith("solve/")]
    batches = list(dict.fromkeys(row.label.rsplit("/", 1)[1] for row in rows))
    cells = [["force solve", "slip / tail speed", *(f"{n} flows, µs" for n in batches)]]
    for name in dict.fromkeys(row.label.split("/")[1] for row in rows):
        same = [row for row in rows if row.label.split("/")[1] == name]
        times = [
            f"{1e6 * spread(row.seconds).median / int(n):.0f}"
            for row, n in zip(same, batches, strict=True)
        ]
        cells.append([name, f"{same[0].facts['slip']:.1e}", *times])
    note = (
        "Step of one flow in a tank of 4 L × 2.5 L; the direct solve costs the same whatever its "
        "slip, the iteration more the less slip there shall be."
    )
    return Table("Force solve", note, cells)


def _tabulate_scaling(results: Results) -> Table:
    cells = [["case", "L", "µs / step", "MLUPS", "s / T", "s / T and flow", "preset"]]
    for row in results.of_group("scaling"):
        seconds = spread(row.seconds).median
        beat = seconds * row.facts["period"]
        cells.append(
            [
                row.name,
                str(row.facts["body_length"]),
                f"{1e6 * seconds:.0f}",
                f"{row.mlups.median:.0f}",
                f"{beat:.2f}",
                f"{beat / row.facts['flows']:.2f}",
                row.facts["preset"] or "–",
            ]
        )
    return Table("Price of a step, and of a tail beat T", "A swimming fish in each flow.", cells)


def _tabulate_actions(results: Results) -> Table:
    cells = [["case", "ms / action", "beyond the bare solver, %", "share outside the flow, %"]]
    bare = results.find("env/solver")
    for row in results.of_group("env"):
        outside = row.extras.get("share_outside_flow", [])
        beyond = "–"
        if bare is not None and row is not bare:
            beyond = format_spread(Spread(*(100 * (x - 1) for x in compare_times(row, bare))))
        share = format_spread(Spread(*(100 * x for x in spread(outside)))) if outside else "–"
        times = Spread(*(1e3 * s for s in spread(row.seconds)))
        cells.append([row.name, format_spread(times, 0), beyond, share])
    return Table("Environment", "One action per tail beat T.", cells)


def _tabulate_training(results: Results) -> Table:
    cells = [["case", "ms", "share of learning, %"]]
    for row in results.of_group("train"):
        learning = row.extras.get("share_learning", [])
        share = format_spread(Spread(*(100 * x for x in spread(learning))), 1) if learning else "–"
        times = Spread(*(1e3 * s for s in spread(row.seconds)))
        cells.append([row.name, format_spread(times, 0 if row.scope == FISH else 2), share])
    return Table("Training", "", cells)


def _tabulate_profile(results: Results) -> Table:
    study = results.studies.get("profile")
    cells = [["part", "of", "ms / action", "share, %"]]
    if study is None:
        return Table("", "", cells)
    total = sum(row["seconds"] for row in study["rows"])
    for row in study["rows"]:
        share = 100 * row["seconds"] / total
        cells.append([row["part"], row["where"], f"{1e3 * row['seconds']:.1f}", f"{share:.2f}"])
    note = (
        f"{study['num_envs']} × {study['size']}, {study['substeps']} steps, one core, all in one "
        "process."
    )
    return Table("Where the time of an environment step goes", note, cells)


def _tabulate_studies(results: Results) -> Table:
    cells = [["what", "measured"]]
    for name, seconds in results.studies.get("compile", {}).items():
        cells.append([f"compile of a step with fish, {name}", f"{seconds:.1f} s"])
    cells += [
        [f"memory, {row['name']}", f"{row['bytes_per_node']:.1f} B / node"]
        for row in results.studies.get("memory", {}).get("rows", [])
    ]
    return Table("Compilation and memory", "", cells)


def _tabulate_cuda(results: Results) -> Table:
    """Return what a GPU would be asked to do."""
    keys = ("kernels", "library_calls", "temporaries", "loads", "stores")
    rows = results.studies.get("cuda", {}).get("rows", [])
    cells = [["part", *(key.replace("_", " ") for key in keys)]]
    cells += [[row["name"], *(str(row[key]) for key in keys)] for row in rows]
    note = "Inductor's Triton source for one step of two flows, counted and not run."
    return Table("Code for a GPU", note, cells)


def describe_run(results: Results) -> str:
    """Return one paragraph: machine, versions, protocol and who was left out."""
    machine, settings = results.machine, results.settings
    caches = ", ".join(f"{k} {v / 2**20:g} MB" for k, v in machine["caches"].items())
    versions = ", ".join(f"{k} {v}" for k, v in machine["versions"].items())
    words = [
        f"{machine['cpu']}, {machine['cores']} cores, {settings['threads']} threads per code, "
        f"{machine['instructions']}; {caches or 'caches unknown'}; "
        f"GPU: {machine['gpu'] or 'none'}; load at start {machine['load']}.",
        f"torch {machine['torch']}, Python {machine['python']}, {versions}.",
        f"{settings['rounds']} rounds of bursts of {1e3 * settings['burst']:.0f} ms, single "
        "precision.",
    ]
    words += [f"Left out: {s.code} ({s.group}): {s.why}." for s in results.skipped]
    return " ".join(words)
