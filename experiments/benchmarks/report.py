"""Tables of a run in Markdown: goals, speeds, costs."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from experiments.benchmarks.measuring import Benchmark, Results
from fishrl.files import write_whole
from fishrl.pages import write_table


class Quartiles(NamedTuple):
    """The median and the quartiles of some values."""

    low: float
    median: float
    high: float

    def show(self, digits: int = 2) -> str:
        """Return "1.80 [1.79, 1.81]", or one number if all three agree."""
        low, median, high = (f"{value:.{digits}f}" for value in self)
        return median if low == median == high else f"{median} [{low}, {high}]"


def find_quartiles(values: Sequence[float] | np.ndarray) -> Quartiles:
    """Return the median and the quartiles of some values."""
    return Quartiles(*np.quantile(values, (0.25, 0.5, 0.75)).tolist())


def measure_speed(case: Benchmark) -> Quartiles:
    """Return million node updates per second (MLUPS)."""
    return find_quartiles(1e-6 * case.num_nodes / np.array(case.measured["seconds"]))


def compare_speeds(ours: Benchmark, theirs: Benchmark) -> Quartiles:
    """Return the ratio of the speeds per node update, over the rounds."""
    a, b = (np.array(case.measured["seconds"]) / case.num_nodes for case in (ours, theirs))
    return find_quartiles(b / a)


#: Quantity and target; then, for a least speed ratio (≥), the labels of both benchmarks, or for an
#: upper bound (≤) the name of the measured number and the label of its benchmark.
GOALS = (
    ("GPU, bulk / copy", "≥ 0.9 ×", "gpu/kernel", "gpu/copy"),
    ("GPU, whole step with fish / copy", "≥ 0.75 ×", "gpu/fish", "gpu/copy"),
    (
        "share of an environment step outside the flow, L = 50",
        "≤ 2 %",
        "outside_flow",
        "env/policy",
    ),
    ("gradient step, 64 transitions", "≤ 3 ms", "seconds", "train/gradient"),
    ("memory per node", "≤ 45 B", "bytes", "middle/fish"),
    ("compile, cold", "≤ 45 s", "seconds", "compile/cold"),
    ("compile, warm", "≤ 1 s", "seconds", "compile/warm"),
)


def list_goals(results: Results) -> list[list[str]]:
    """Return each goal that was measured, with target, value, and whether the median meets it."""
    lines = []
    for what, target, quantity, label in GOALS:
        (sign, bound, unit), case = target.split(), results.find(label)
        ours = results.find(quantity) if sign == "≥" else case
        if case and ours:
            if sign == "≥":
                found = compare_speeds(ours, case)
                is_met = found.median >= float(bound)
            else:
                factor = {"%": 100.0, "ms": 1e3}.get(unit, 1.0)
                found = find_quartiles(factor * np.array(case.measured[quantity]))
                is_met = found.median <= float(bound)
            verdict = "met" if is_met else "MISSED"
            lines.append([what, target, f"{found.show()} {unit}", verdict])
    return lines


Cell = Callable[[Benchmark, Results], str | None]


def _number(name: str, digits: int, factor: float = 1.0) -> Cell:
    def show(case: Benchmark, results: Results) -> str | None:
        values = case.measured.get(name)
        return find_quartiles(factor * np.array(values)).show(digits) if values else None

    return show


def _over(label: str, case: Benchmark, results: Results) -> str | None:
    other = results.find(label)
    return f"{compare_speeds(case, other).median:.2f}" if other else None


def _price(case: Benchmark, results: Results) -> str:
    seconds = find_quartiles(case.measured["seconds"]).median
    return f"{seconds * case.facts['period'] / case.facts['flows']:.3f}"


def _time_beat(case: Benchmark) -> float:
    """Return the least seconds of the processor for a beat of one flow."""
    return float(min(case.measured["cpu"]) * case.facts["period"] / case.facts["flows"])


def _error(reynolds: int, case: Benchmark, results: Results) -> str | None:
    error = case.facts["errors"].get(reynolds)
    return None if error is None else f"{100.0 * error:+.1f}"


def _sum_least(names: Sequence[str], case: Benchmark) -> float:
    return sum(min(case.measured[name]) for name in names if name in case.measured)


def _find_share(names: Sequence[str], case: Benchmark) -> float:
    return _sum_least(names, case) / _sum_least(PARTS, case)


def _share(names: Sequence[str], case: Benchmark, results: Results) -> str | None:
    is_there = any(name in case.measured for name in names)
    return f"{100.0 * _find_share(names, case):.0f}" if is_there else None


def compare_levels(results: Results) -> str:
    """Return how the time of three levels compares with uniform grids, with and without bodies."""
    given = [results.find(f"levels/1, {grid}") for grid in ("100, 3", "100, 1", "50, 1")]
    cases = [case for case in given if case]
    if len(cases) < len(given):
        return ""
    fine, same, half = map(_time_beat, cases)
    bare_fine, bare_same, bare_half = (
        _time_beat(case) * (1.0 - _find_share(BODY_PARTS, case)) for case in cases
    )
    return (
        f"Three levels take 1/{same / fine:.1f} of the time of uniform L = 100 (goal: 1/12), and "
        f"{fine / half:.2f} of that of L = 50 (goal: 0.8). If bodies cost nothing on any grid, "
        f"these would be 1/{bare_same / bare_fine:.1f} and {bare_fine / bare_half:.2f}."
    )


def _least(name: str, case: Benchmark, results: Results) -> str | None:
    return f"{1e6 * _sum_least([name], case):.0f}" if name in case.measured else None


#: What a step does for the bodies: reflection or coupling, finding their skins, uncovered nodes.
BODY_PARTS = ("exchange", "skin", "uncovering")
PARTS = ("collision", *BODY_PARTS, "edges", "interface")
#: Content of each column; None is shown as a dash.
COLUMNS: dict[str, Cell] = {
    "case": lambda case, _: case.name,
    "what": lambda case, _: case.scope,
    "MLUPS": lambda case, _: measure_speed(case).show(0),
    "/ copy": partial(_over, "probe/copy"),
    "/ copy on the GPU": partial(_over, "gpu/copy"),
    "memory, B / node": _number("bytes", 1),
    "µs / step": lambda case, _: f"{1e6 * find_quartiles(case.measured['seconds']).median:.0f}",
    "s / T and flow": _price,
    "ms": _number("seconds", 2, 1e3),
    "share outside the flow, %": _number("outside_flow", 2, 100.0),
    "share of learning, %": _number("learning", 1, 100.0),
    "seconds": _number("seconds", 1),
    "step, µs": partial(_least, "seconds"),
    **{name: partial(_least, name) for name in PARTS},
    "step / collision": lambda case, _: (
        f"{_sum_least(['seconds'], case) / _sum_least(['collision'], case):.2f}"
    ),
    "s / T": lambda case, _: f"{min(case.measured['seconds']) * case.facts['period']:.3f}",
    "CPU s / T": lambda case, _: f"{_time_beat(case):.3f}",
    "Re = 500, %": partial(_error, 500),
    "Re = 7142, %": partial(_error, 7142),
    "updates / T": lambda case, _: f"{1e-6 * case.facts['updates']:.0f} M",
    "bodies, %": partial(_share, BODY_PARTS),
    "interface, %": partial(_share, ["interface"]),
    "decisions / s": lambda case, _: (
        f"{case.facts['flows'] / find_quartiles(case.measured['seconds']).median:.0f}"
    ),
    "first decision, s": _number("first", 0),
    "memory, GB": _number("memory", 1, 1e-9),
}
SPEED = ("case", "what", "MLUPS", "/ copy")
GPU_SPEED = ("case", "what", "MLUPS", "/ copy on the GPU")
MEMORY, PRICE = "memory, B / node", ("µs / step", "s / T and flow")
OUTSIDE = ("case", "ms", "share outside the flow, %")
STEPS = ("case", "step, µs", *PARTS, "step / collision", "s / T")
ERRORS = ("Re = 500, %", "Re = 7142, %")
#: Group, heading, line above the table, columns.
TABLES: tuple[tuple[str, str, str, tuple[str, ...]], ...] = (
    ("probe", "Memory bandwidth", "", SPEED),
    ("solver", "Flow without bodies", "", (*SPEED, MEMORY)),
    ("coupled", "A swimming fish in each flow", "T is a tail beat.", (*SPEED, MEMORY, *PRICE)),
    (
        "levels",
        "Grids",
        "",
        ("case", "what", *ERRORS, "updates / T", "CPU s / T", "bodies, %", "interface, %"),
    ),
    ("gpu", "GPU", "", GPU_SPEED),
    ("env", "Environment", "Bursts of one action, which lasts a tail beat T.", OUTSIDE),
    ("train", "Training", "", ("case", "ms", "share of learning, %")),
    (
        "steps",
        "Steps of the presets",
        "Least times of one flow on one core. T is the task's unit of time.",
        STEPS,
    ),
    ("decisions", "Decisions", "", ("case", "decisions / s", "share outside the flow, %")),
    (
        "tasks",
        "Tasks of the benchmark",
        "Random actions in 16 flows; compiled code and wakes are cached. T is the task's unit.",
        ("case", "decisions / s", "s / T and flow", "first decision, s", "memory, GB"),
    ),
    ("compile", "Compilation", "Time until the first step with a fish.", ("case", "seconds")),
)


#: Marks, their page, and the groups whose tables stand between them; goals summarise the others.
PRESETS, MEASURED, GRIDS = "presets", "measured", "grids"
PAGES = {
    PRESETS: ("performance.md", ("steps", "decisions", "tasks")),
    MEASURED: ("performance.md", ("coupled", "gpu")),
    GRIDS: ("resolution.md", ("levels",)),
}


def render_results(results: Results, mark: str | None = None) -> str:
    """Return a description of the run, its goals and the tables of a mark, by default of all."""
    tables, goals = [], list_goals(results)
    if goals and mark in (None, MEASURED):
        table = write_table(("goal", "target", "measured", "result"), goals)
        tables = [f"### Goals\n\nRatios of the same round: median and quartiles.\n\n{table}"]
    for group, title, note, columns in TABLES:
        if (mark is None or group in PAGES[mark][1]) and (cases := results.of_group(group)):
            cells = [[COLUMNS[c](case, results) or "–" for c in columns] for case in cases]
            below = compare_levels(results) if group == "levels" else ""
            parts = [f"### {title}", note, write_table(columns, cells), below]
            tables.append("\n\n".join(filter(None, parts)))
    return "\n\n".join(table.strip() for table in (describe_run(results), *tables))


def describe_run(results: Results) -> str:
    """Return one paragraph: machine, versions and protocol."""
    machine, settings = results.machine, results.settings
    caches = ", ".join(f"{k} {v / 2**20:g} MB" for k, v in machine["caches"].items())
    versions = ", ".join(f"{k} {v}" for k, v in machine["versions"].items())
    return (
        f"{machine['cpu']}, {machine['cores']} cores, {settings['threads']} threads, "
        f"{machine['instructions']}; {caches or 'caches unknown'}; "
        f"GPU: {machine['gpu'] or 'none'}; load at start {machine['load']}. "
        f"torch {machine['torch']}, Python {machine['python']}, {versions}. {settings['rounds']} "
        f"rounds of bursts of {1e3 * settings['burst']:.0f} ms, single precision; commit "
        f"{machine.get('commit', 'unknown')[:8]}."
    )


def write_pages(results: Results, figures: dict[Path, str], docs: Path) -> None:
    """Replace the text between the marks of pages by tables and figures with captions.

    Marks whose groups were not measured keep theirs.
    """
    pictures = [f"![{caption}]({path.relative_to(docs)})" for path, caption in figures.items()]
    for mark, (name, groups) in PAGES.items():
        if not any(map(results.of_group, groups)):
            continue
        page = docs / name
        text = page.read_text(encoding="utf-8")
        begin, end = (f"<!-- {mark}: {place} -->" for place in ("begin", "end"))
        before, found, rest = text.partition(begin)
        _, closed, after = rest.partition(end)
        if not (found and closed):
            raise ValueError(f"{page}: put one line {begin} and below it one line {end} into it")
        new = "\n\n".join([render_results(results, mark), *pictures * (mark == MEASURED)])
        write_whole(page, f"{before}{begin}\n{new}\n{end}{after}")
