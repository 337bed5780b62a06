"""The tables of a run in Markdown: targets and whether they are met, speeds, costs."""

from __future__ import annotations

import math
from pathlib import Path

from experiments.benchmarks.comparison import Row
from experiments.benchmarks.plots import write_plots
from experiments.benchmarks.results import Results, Spread, compare, measure_speed, read, spread
from experiments.pages import fill, write_table

MARK = "measured"  # name of the place of the page that is filled
IN_PLACE = ("lbmpy/aa, kernel", "lbmpy/esotwist, kernel")
ONE, MANY = "one swimming fish", "16 flows, a fish in each"
#: Speed per node update of a row over that of the fastest of some others: what, least, labels.
RATIOS: tuple[tuple[str, float, str, tuple[str, ...]], ...] = (
    ("flow and walls / lbmpy's in-place kernel", 0.80, "large/walls", IN_PLACE),
    ("flow and walls / lbmpy's two-buffer step", 1.8, "large/walls", ("lbmpy/pull",)),
    ("flow and walls / numba", 1.6, "large/walls", ("numba/step",)),
    ("flow and walls / lettuce compiled", 17.0, "large/walls", ("lettuce/compiled",)),
    (f"{ONE} / lbmpy's in-place kernel", 0.65, "large/fish", IN_PLACE),
    (f"{ONE} / lbmpy's two-buffer step without a body", 1.4, "large/fish", ("lbmpy/pull",)),
    (f"{MANY} / lbmpy's in-place kernel, large", 0.50, "batch16/fish", IN_PLACE),
    (
        f"{MANY} / lbmpy's in-place kernel, same 16 flows one by one",
        0.50,
        "batch16/fish",
        ("lbmpy/batch16",),
    ),
    ("GPU, bulk / copy", 0.90, "gpu/kernel", ("gpu/copy",)),
    ("GPU, whole step with fish / copy", 0.75, "gpu/fish", ("gpu/copy",)),
    ("GPU, stored in half / in single precision", 1.6, "gpu/fish, half", ("gpu/fish",)),
)
#: The largest of a number of some rows: what, most, unit, number, labels.
LIMITS: tuple[tuple[str, float, str, str, tuple[str, ...]], ...] = (
    ("share of an environment step outside the flow", 2.0, "%", "outside_flow", ("env/policy",)),
    ("memory per node and flow", 45.0, "B", "bytes", ("large/fish", "middle/fish")),
    ("compile, cold", 45.0, "s", "seconds", ("compile/cold",)),
    ("compile, warm", 1.0, "s", "seconds", ("compile/warm",)),
)


def list_targets(results: Results) -> list[list[str]]:
    """Return each quantity, its target, what was measured, and whether the median meets it."""
    lines = []
    for what, least, label, labels in RATIOS:
        ours, others = results.find(label), [row for row in map(results.find, labels) if row]
        best = max(others, key=lambda row: measure_speed(row).median, default=None)
        ratio = compare(ours, best) if ours and best else None
        lines.append([what, f"≥ {least:g} ×", *_show_result(ratio, "×", least, math.inf)])
    for what, most, unit, name, labels in LIMITS:
        rows = [row for row in map(results.find, labels) if row]
        found = max((number for row in rows if (number := read(row, name))), default=None)
        lines.append([what, f"≤ {most:g} {unit}", *_show_result(found, unit, -math.inf, most)])
    return lines


def _show_result(measured: Spread | None, unit: str, least: float, most: float) -> list[str]:
    """Return a measured number and whether its median is within bounds."""
    if measured is None:
        return ["–", "not measured"]
    factor = 100.0 if unit == "%" else 1.0
    is_met = least <= factor * measured.median <= most
    return [f"{measured.show(scale=factor)} {unit}", "met" if is_met else "MISSED"]


SPEED = ("case", "code", "what", "MLUPS", "/ copy", "/ in-place probe", "B / update", "MB")
MEMORY, PRICE = "memory, B / node", ("µs / step", "s / T and flow")
#: Group, heading, line above the table (with facts of its first row), columns of ``show_cells``.
TABLES = (
    ("probe", "What the memory does", "", SPEED),
    ("solver", "The flow", "", (*SPEED, MEMORY)),
    ("coupled", "A swimming fish in each flow", "T is a tail beat.", (*SPEED, MEMORY, *PRICE)),
    ("peers", "Other codes", "", SPEED),
    ("gpu", "GPU", "", SPEED),
    (
        "env",
        "Environment",
        "Bursts of one action, which lasts a tail beat T.",
        ("case", "ms", "beyond the bare solver, %", "share outside the flow, %"),
    ),
    ("train", "Training", "", ("case", "ms", "share of learning, %")),
    (
        "live",
        "Live view",
        "Bursts of one action; the flows have processes of their own.",
        ("case", "ms", "processor time of the main process, %"),
    ),
    (
        "profile",
        "Where the time of an environment step goes",
        "{size}, one core, all in one process, by torch.profiler.",
        ("part", "of", "ms / action", "share, %"),
    ),
    ("compile", "Compilation", "Time until the first step with a fish.", ("case", "seconds")),
)
#: Columns of numbers that rows have: number of ``read``, digits, factor.
NUMBERS = {
    MEMORY: ("bytes", 1, 1.0),
    "ms": ("seconds", 2, 1e3),
    "ms / action": ("seconds", 1, 1e3),
    "seconds": ("seconds", 1, 1.0),
    "share outside the flow, %": ("outside_flow", 2, 100.0),
    "share of learning, %": ("learning", 1, 100.0),
    "processor time of the main process, %": ("processor", 2, 100.0),
    "share, %": ("share", 2, 100.0),
}


def show_cells(row: Row, results: Results) -> dict[str, str]:
    """Return what is known of a row, by column."""
    cells = {"case": row.name, "part": row.name, "code": row.code, "what": row.scope}
    cells |= {"of": row.facts.get("place", ""), "MB": f"{row.working_set / 1e6:.1f}"}
    cells["B / update"] = str(row.bytes_per_update)
    for column, (name, digits, factor) in NUMBERS.items():
        if found := read(row, name):
            cells[column] = found.show(digits, factor)
    if row.seconds:
        cells["MLUPS"] = measure_speed(row).show(0)
        for column, label in (("/ copy", "probe/copy"), ("/ in-place probe", "probe/in place")):
            if probe := results.find(label):
                cells[column] = f"{compare(row, probe).median:.2f}"
        seconds, bare = spread(row.seconds).median, results.find("env/solver")
        cells["µs / step"] = f"{1e6 * seconds:.0f}"
        if "period" in row.facts:
            cells["s / T and flow"] = f"{seconds * row.facts['period'] / row.facts['flows']:.2f}"
        if bare and row.group == "env" and row is not bare:
            excess = Spread(*(100.0 * (ratio - 1.0) for ratio in compare(bare, row)))
            cells["beyond the bare solver, %"] = excess.show()
    return cells


def list_tables(results: Results) -> list[str]:
    """Return every table that there is something to put into, in Markdown."""
    targets = write_table(("goal", "target", "measured", "result"), list_targets(results))
    tables = [f"### Goals\n\nRatios of the same round: median and quartiles.\n\n{targets}"]
    for group, title, note, columns in TABLES:
        if rows := results.of_group(group):
            cells = [show_cells(row, results) for row in rows]
            table = write_table(columns, [[row.get(c, "–") for c in columns] for row in cells])
            parts = [f"### {title}", note.format(**rows[0].facts), table]
            tables.append("\n\n".join(filter(None, parts)))
    return [table.strip() for table in tables]


def describe_run(results: Results) -> str:
    """Return one paragraph: machine, versions, protocol and which codes were left out."""
    machine, settings = results.machine, results.settings
    caches = ", ".join(f"{k} {v / 2**20:g} MB" for k, v in machine["caches"].items())
    versions = ", ".join(f"{k} {v}" for k, v in machine["versions"].items())
    sentences = [
        f"{machine['cpu']}, {machine['cores']} cores, {settings['threads']} threads per code, "
        f"{machine['instructions']}; {caches or 'caches unknown'}; "
        f"GPU: {machine['gpu'] or 'none'}; load at start {machine['load']}.",
        f"torch {machine['torch']}, Python {machine['python']}, {versions}.",
        f"{settings['rounds']} rounds of bursts of {1e3 * settings['burst']:.0f} ms, single "
        "precision.",
    ]
    sentences += [f"Left out: {s.code} ({s.group}): {s.why}." for s in results.skipped]
    return " ".join(sentences)


def write_page(results: Results, docs: Path) -> list[Path]:
    """Put tables and figures into ``performance.md``, and return the files written.

    Raises:
        ValueError: if the page is missing, or its marks are.
    """
    page = docs / "performance.md"
    figures = write_plots(results, docs / "figures" / "benchmark")
    pictures = [f"![{caption}](figures/benchmark/{path.name})" for path, caption in figures.items()]
    fill(page, MARK, "\n\n".join([describe_run(results), *list_tables(results), *pictures]))
    return [page, *figures]
