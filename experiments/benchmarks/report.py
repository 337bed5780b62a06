"""The tables of a run in Markdown: goals and whether they are met, speeds, costs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from experiments.benchmarks.contest import Row
from experiments.benchmarks.plots import write_plots
from experiments.benchmarks.results import Results, Spread, compare, measure_speed, spread
from experiments.pages import divide, fill, write_table

MARK = "measured"  # name of the place of the page that is filled
GOAL_HEADS = ("goal", "bar", "measured", "verdict")


class Goal(NamedTuple):
    """A number and its bar.

    Attributes:
        what: is measured.
        bar: to be reached.
        unit: of both.
        measure: returns the number, or None where something it needs was not measured.
        is_floor: whether the number should be at least the bar, not at most.
    """

    what: str
    bar: float
    unit: str
    measure: Callable[[Results], Spread | None]
    is_floor: bool = False

    def judge(self, results: Results) -> list[str]:
        """Return goal, bar, what was measured, and whether the median meets the bar."""
        bar = f"{'≥' if self.is_floor else '≤'} {self.bar:g} {self.unit}"
        found = self.measure(results)
        if found is None:
            return [self.what, bar, "–", "not measured"]
        gap = found.median - self.bar
        is_met = gap >= 0.0 if self.is_floor else gap <= 0.0
        return [self.what, bar, f"{found.show()} {self.unit}", "met" if is_met else "MISSED"]


def at_least(bar: float, what: str, label: str, *others: str) -> Goal:
    """Return the goal to be ``bar`` times as fast per node update as the fastest other row."""

    def measure(results: Results) -> Spread | None:
        ours, found = results.find(label), [row for row in map(results.find, others) if row]
        if ours is None or not found:
            return None
        return compare(ours, max(found, key=lambda row: measure_speed(row).median))

    return Goal(what, bar, "×", measure, is_floor=True)


def at_most(bar: float, what: str, unit: str, fact: str, *labels: str) -> Goal:
    """Return the goal that a number of some rows stays below a bar."""

    def measure(results: Results) -> Spread | None:
        values = [row.facts[fact] for row in map(results.find, labels) if row]
        return Spread(*[max(values)] * 3) if values else None

    return Goal(what, bar, unit, measure)


def measure_overhead(results: Results) -> Spread | None:
    """Return how many percent of a whole environment step are not spent in the flow."""
    row = results.find("env/policy")
    return None if row is None else spread([100.0 * x for x in row.extras["outside_flow"]])


IN_PLACE = ("lbmpy/aa, kernel", "lbmpy/esotwist, kernel")
ONE, MANY = "one swimming fish", "16 flows, a fish in each"
GOALS = (
    at_least(0.80, "flow and walls / lbmpy's in-place kernel", "large/walls", *IN_PLACE),
    at_least(1.8, "flow and walls / lbmpy's two-buffer step", "large/walls", "lbmpy/pull"),
    at_least(1.6, "flow and walls / numba", "large/walls", "numba/step"),
    at_least(17.0, "flow and walls / lettuce compiled", "large/walls", "lettuce/compiled"),
    at_least(0.65, f"{ONE} / lbmpy's in-place kernel", "large/fish", *IN_PLACE),
    at_least(1.4, f"{ONE} / lbmpy's two-buffer step without a body", "large/fish", "lbmpy/pull"),
    at_least(0.50, f"{MANY} / lbmpy's in-place kernel, large", "batch16/fish", *IN_PLACE),
    at_least(
        0.50,
        f"{MANY} / lbmpy's in-place kernel, same 16 flows one by one",
        "batch16/fish",
        "lbmpy/batch16",
    ),
    at_least(0.90, "GPU, bulk / copy", "gpu/kernel", "gpu/copy"),
    at_least(0.75, "GPU, whole step with fish / copy", "gpu/fish", "gpu/copy"),
    at_least(1.6, "GPU, stored in half / in single precision", "gpu/fish, half", "gpu/fish"),
    Goal("share of an environment step outside the flow", 2.0, "%", measure_overhead),
    at_most(45.0, "memory per node and flow", "B", "bytes", "large/fish", "middle/fish"),
    at_most(45.0, "compile, cold", "s", "seconds", "compile/cold"),
    at_most(1.0, "compile, warm", "s", "seconds", "compile/warm"),
)


def show_ratio(row: Row, results: Results, label: str) -> str:
    """Return the median of a row's speed over that of another."""
    other = results.find(label)
    return f"{compare(row, other).median:.2f}" if other else "–"


def show_excess(row: Row, results: Results) -> str:
    """Return by how many percent actions take longer than in the bare solver."""
    bare = results.find("env/solver")
    if bare is None or bare is row:
        return "–"
    return Spread(*(100.0 * (ratio - 1.0) for ratio in compare(bare, row))).show()


def show_share(row: Row, name: str) -> str:
    """Return a share that came with the bursts, in percent."""
    return spread(row.extras[name]).show(scale=100.0) if name in row.extras else "–"


Columns = dict[str, Callable[[Row, Results], str]]
CASE: Columns = {"case": lambda row, _: row.name}
SPEED: Columns = CASE | {
    "code": lambda row, _: row.code,
    "what": lambda row, _: row.scope,
    "MLUPS": lambda row, _: measure_speed(row).show(0),
    "/ copy": lambda row, results: show_ratio(row, results, "probe/copy"),
    "/ in-place probe": lambda row, results: show_ratio(row, results, "probe/in place"),
    "B / update": lambda row, _: str(row.bytes_per_update),
    "MB": lambda row, _: f"{row.working_set / 1e6:.1f}",
}
MEMORY: Columns = {
    "memory, B / node": lambda row, _: f"{row.facts['bytes']:.1f}" if "bytes" in row.facts else "–"
}
PRICE: Columns = {
    "µs / step": lambda row, _: f"{1e6 * spread(row.seconds).median:.0f}",
    "s / T and flow": lambda row, _: (
        f"{spread(row.seconds).median * row.facts['period'] / row.facts['flows']:.2f}"
    ),
}
ACTION: Columns = CASE | {"ms": lambda row, _: spread(row.seconds).show(scale=1e3)}
PART: Columns = {"part": lambda row, _: row.name}
#: Group, heading, line above the table (with facts of its first row), columns.
TABLES: tuple[tuple[str, str, str, Columns], ...] = (
    ("probe", "What the memory does", "", SPEED),
    ("solver", "The flow", "", SPEED | MEMORY),
    ("coupled", "A swimming fish in each flow", "T is a tail beat.", SPEED | MEMORY | PRICE),
    ("peers", "Other codes", "", SPEED),
    ("gpu", "GPU", "", SPEED),
    (
        "env",
        "Environment",
        "Bursts of one action, which lasts a tail beat T.",
        ACTION
        | {
            "beyond the bare solver, %": show_excess,
            "share outside the flow, %": lambda row, _: show_share(row, "outside_flow"),
        },
    ),
    (
        "train",
        "Training",
        "",
        ACTION | {"share of learning, %": lambda row, _: show_share(row, "learning")},
    ),
    (
        "live",
        "Live view",
        "Bursts of one action; the flows have processes of their own.",
        ACTION | {"processor time of the main process, %": lambda r, _: show_share(r, "processor")},
    ),
    (
        "profile",
        "Where the time of an environment step goes",
        "{size}, one core, all in one process, by torch.profiler.",
        PART
        | {
            "of": lambda row, _: row.facts["place"],
            "ms / action": lambda row, _: f"{1e3 * row.facts['seconds']:.1f}",
            "share, %": lambda row, _: f"{100.0 * row.facts['share']:.2f}",
        },
    ),
    (
        "compile",
        "Compilation",
        "Time until the first step with a fish.",
        CASE | {"seconds": lambda row, _: f"{row.facts['seconds']:.1f}"},
    ),
    (
        "cuda",
        "Code for a GPU",
        "Inductor's Triton source for one step of two flows, counted and not run.",
        PART
        | {
            "kernels": lambda row, _: str(row.facts["kernels"]),
            "library calls": lambda row, _: str(row.facts["library calls"]),
            "temporaries": lambda row, _: str(row.facts["temporaries"]),
            "loads": lambda row, _: str(row.facts["loads"]),
            "stores": lambda row, _: str(row.facts["stores"]),
        },
    ),
)


def list_tables(results: Results) -> list[str]:
    """Return every table that there is something to put into, in Markdown."""
    goals = write_table(GOAL_HEADS, [goal.judge(results) for goal in GOALS])
    tables = [f"### Goals\n\nRatios of the same round: median and quartiles.\n\n{goals}"]
    for group, title, note, columns in TABLES:
        if rows := results.of_group(group):
            cells = [[show(row, results) for show in columns.values()] for row in rows]
            parts = [f"### {title}", note.format(**rows[0].facts), write_table([*columns], cells)]
            tables.append("\n\n".join(filter(None, parts)))
    return [table.strip() for table in tables]


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


def write_page(results: Results, docs: Path) -> list[Path]:
    """Put tables and figures into ``performance.md``, and return the files written.

    Raises:
        ValueError: if the page is missing, or its marks are.
    """
    page = docs / "performance.md"
    divide(page, MARK)  # a page that cannot be filled is found before anything is drawn
    figures = write_plots(results, docs / "figures" / "benchmark")
    pictures = [f"![{caption}](figures/benchmark/{path.name})" for path, caption in figures.items()]
    fill(page, MARK, "\n\n".join([describe_run(results), *list_tables(results), *pictures]))
    return [page, *figures]
