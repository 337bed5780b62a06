"""Numbers of pages, validation cases and studies, as conclusions name them."""

import json
import re
from collections.abc import Sequence
from pathlib import Path
from statistics import fmean, stdev

from scipy import stats

from fishrl.benchmark import Row, list_rows
from fishrl.programs.statistics import Interval, find_mean
from studies.blind_by_reward.sweep import choose_rule, read_scores
from studies.drawn_paths.paths import read_shares
from studies.tables import read_data

DOCS = Path(__file__).parents[2] / "docs"
NUMBER = r"[+−-]?\d+(?:\.\d+)?"
STREAM, RESOLUTION, BODY = "tutorials/fish_in_a_stream.md", "resolution.md", "tutorials/own_body.md"
RESULTS, ALGORITHMS, SPEED, README = "results.md", "algorithms.md", "performance.md", "../README.md"
C_START, CHANGING, SEVERAL = (
    "tasks/c_start.md",
    "tasks/changing_streams.md",
    "tasks/several_fish.md",
)
SENSES, GAIT, PREDATION = "tasks/senses.md", "tasks/karman_gait.md", "tasks/predation.md"
EVERY = (README, *sorted(str(path.relative_to(DOCS)) for path in DOCS.rglob("*.md")))
#: The list of changes, verdicts that ``make validate`` writes, and what ``make docs`` generates.
OTHERS = ("changelog.md", "validation.md", "configuration.md", "task_reference.md")
PAGES = tuple(page for page in EVERY if page not in OTHERS)

Numbers = Sequence[float]


def read(page: str) -> str:
    return " ".join((DOCS / page).read_text(encoding="utf-8").split())


def match_words(text: str, words: str) -> re.Match[str] | None:
    """Find words in which ``#`` stands for a number."""
    return re.search(re.escape(words).replace(r"\#", f"({NUMBER})").replace(r"\ ", " "), text)


def find(page: str, words: str) -> list[str]:
    """Return the numbers ``#`` of a passage that a page must have."""
    match = match_words(read(page), words)
    assert match, f"{page}: no longer says: {words}"
    return [number.replace("−", "-") for number in match.groups()]


def find_rows(page: str, *starts: str) -> list[list[float]]:
    """Return the numbers of a table's rows, by their first cells."""
    cells = "".join(r"\| " + re.escape(cell) + " " * bool(cell) for cell in starts)
    rows = re.findall(rf"^{cells}\|(.*)\|$", (DOCS / page).read_text("utf-8"), re.MULTILINE)
    return [[float(n.replace("−", "-")) for n in re.findall(NUMBER, row)] for row in rows]


def find_row(page: str, *starts: str) -> list[float]:
    """Return the numbers of the only row with these first cells."""
    (row,) = find_rows(page, *starts)
    return row


def measured(case: str, quantity: str, resolution: str | None = None) -> float:
    """Return a result of a validation case, by default on its finest grid."""
    checks = json.loads((DOCS / "validation" / f"{case}.json").read_text(encoding="utf-8"))
    (found,) = [one for one in checks["checks"] if one["quantity"] == quantity]
    return float(found["ours"] if resolution is None else found["refinement"][resolution])


def swum() -> dict[str, float]:
    """Return the speed of a fish with an immersed boundary by its length."""
    checks = json.loads((DOCS / "validation/swimmer.json").read_text(encoding="utf-8"))["checks"]
    found: dict[str, float] = checks[0]["refinement"]
    return found


def off(value: float, reference: float) -> float:
    """Return a deviation in percent."""
    return 100.0 * (value / reference - 1.0)


def column(study: str, table: str, name: str, **of: str) -> list[float]:
    """Return the numbers of a column of a study's table, in the rows with some entries."""
    wanted = {key.replace("_", " "): entry for key, entry in of.items()}
    rows = [row for row in read_data(study, table) if wanted.items() <= row.items()]
    assert rows, wanted
    return [float(row[name]) for row in rows if row[name]]


def scatter(values: Sequence[float]) -> tuple[float, float]:
    """Return the mean and half of its 95 % interval."""
    half = stats.t.ppf(0.975, len(values) - 1) * stdev(values) / len(values) ** 0.5
    return fmean(values), half


def compare(ours: Sequence[float], theirs: Sequence[float]) -> list[float]:
    """Return the difference of two means and its 95 % interval, by Welch."""
    found = stats.ttest_ind(ours, theirs, equal_var=False)
    return [fmean(ours) - fmean(theirs), *found.confidence_interval()]


def stretch(values: Sequence[float]) -> tuple[float, float]:
    return min(values), max(values)


def gain(grid: str, name: str) -> float:
    """Return the percentage by which the best C-start exceeds the published one."""
    best, published = (
        column("c_start", "distances", name, nodes_per_L=grid, strokes=strokes)[0]
        for strokes in ("best", "published")
    )
    return off(best, published)


def count_lasting(table: str, policy: str) -> list[float]:
    """Return how many episodes of the Kármán gait ended early, and of how many."""
    num = column("karman_gait", table, "episodes", policy=policy)
    lasted = column("karman_gait", table, "lasted, %", policy=policy)
    each = [round(n * share / 100) for n, share in zip(num, lasted, strict=True)]
    return [sum(num) - sum(each), sum(num)]


def lasted(table: str, stream: str) -> float:
    """Return the mean duration without modules in a stream, T."""
    of = {"policy": "ablation", "stream,_L/T": stream}
    return fmean(column("karman_gait", table, "duration, T", **of))


def follow(table: str, who: str, name: str) -> list[float]:
    """Return a column of followers, learned or by hand."""
    rows = [row for row in read_data("following", table) if row["policy"].startswith(who)]
    return [float(row[name]) for row in rows]


RELATIVE, DISTANCE, WORK = "relative to `keep_place` alone", "distance, L", "work, ρ L⁴ / T²"
BEHIND = "mean of 3 policies, behind", "`keep_place`, behind"


def swim(length: int, column: int) -> float:
    """Return the share of its converged speed of a fish on a uniform grid, Re = 500 or 7142."""
    return 1.0 + find_row(RESOLUTION, f"L = {length}", "uniform")[column] / 100.0


def swim_blurred(length: int) -> float:
    """Return that share with the immersed boundary, Re = 7142."""
    text = match_words(read(RESOLUTION), "speeds are #, #, #, #, # and # % below the limit with L")
    assert text
    return 1.0 - float(text[1 + (32, 50, 70, 100, 140, 200).index(length)]) / 100.0


FAST = {
    what: json.loads((DOCS / "validation/compressibility.json").read_text("utf-8"))["checks"][row][
        "refinement"
    ]
    for what, row in (("swim", 1), ("drag", 3), ("lift", 4))
}


def find_line(start: str) -> str:
    """Return a row of the table of presets."""
    (row,) = re.findall(rf"^\| {start} \|.*$", (DOCS / RESOLUTION).read_text("utf-8"), re.MULTILINE)
    return row


def list_verdicts() -> list[str]:
    pages = [json.loads(path.read_text("utf-8")) for path in DOCS.glob("validation/*.json")]
    return [check["verdict"] for page in pages for check in page["checks"]]


def forces(words: str) -> tuple[float, float]:
    along, across = map(float, find(STREAM, words))
    return along, across


def is_above(row: Numbers, *, best: int, than: slice) -> bool:
    """Return whether a number of a row is above the interval of others."""
    return row[best] > sum(scatter(row[than]))


def overlap(page: str, *rows: str) -> bool:
    """Return whether the intervals of the durations in some rows have something in common."""
    ends = [
        (mean - half, mean + half) for _, mean, half, *_ in (find_row(page, row) for row in rows)
    ]
    return max(low for low, _ in ends) <= min(high for _, high in ends)


def learned(arm: str, starts: str = "test") -> tuple[list[float], list[float]]:
    """Return durations, T, and the shares that last, %, of the trainings by reward alone."""
    scores = read_scores(arm)
    found = [each[f"{choose_rule(scores)}/{starts}"] for each in scores]
    return [each["T"] for each in found], [100.0 * each["lasts"] for each in found]


def differ(*arms: str, starts: str = "test") -> Interval:
    """Return the mean difference of two arms' durations by reward alone, paired by seed."""
    one, other = (learned(arm, starts)[0] for arm in arms)
    return find_mean([a - b for a, b in zip(one, other, strict=True)])


def count_published() -> int:
    """Return how many cases of validation have a criterion whose source has a year."""
    cases = [json.loads(path.read_text("utf-8")) for path in DOCS.glob("validation/*.json")]
    judged = [[c for c in case["checks"] if c["verdict"] != "recorded"] for case in cases]
    year = re.compile(r"\b(?:19|20)\d\d\b")
    return sum(any(year.search(check["source"]) for check in checks) for checks in judged)


def list_scored(task: str, policy: str = "discrete_sac") -> list[Row]:
    """Return the benchmark's rows of a policy, or of its trainings."""
    return [row for row in list_rows(task, "test") if row.policy.startswith(policy)]


def score(task: str) -> float:
    """Return the mean of the benchmark's measure over the trainings by discrete SAC."""
    return fmean(row.value for row in list_scored(task))


def lasting(task: str, policy: str = "discrete_sac") -> list[float]:
    """Return the shares of the benchmark's starts from which they succeed, %."""
    return [100.0 * row.metrics["success_rate"] for row in list_scored(task, policy)]


def catch(arm: str, paths: str = "as trained") -> list[float]:
    """Return the shares of starts with a capture on drawn paths, of each seed, %."""
    return [*read_shares(arm, paths).values()]


def last(policy: str, senses: str) -> list[float]:
    """Return how many of 24 starts each seed lasts from."""
    return find_row(SENSES, f"{policy} of the first policy", senses)[:2]


def taught(observed: str) -> float:
    (value,) = column("four_arms", "recognition", "new: duration, T", observed=observed)
    return value


SEEN, SENSE, OWN = (
    "place, drift, heading, own motion",
    "lateral line, own motion",
    "own motion alone",
)
EXTRAPOLATED = "distance after 2.7 T, L, extrapolated to an infinitely fine grid"
PRINTED = (
    "anguilliform: mean force along the stream # ρ L³/T² "
    "carangiform: mean force along the stream # ρ L³/T²"
)
