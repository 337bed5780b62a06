"""Numbers in tables of pages that repeat the data of studies."""

# ruff: noqa: F403, F405 - the tables are written in the words of page_numbers
import re
from collections.abc import Callable
from dataclasses import astuple

from studies.tables import read_data
from tests.docs.page_numbers import *

PAIR = {who: read_data("predation", "pair")[row] for row, who in enumerate(("learned", "pursuit"))}
PAPER = {
    row["part, L = 100"].split(",")[0]: row["ours"] for row in read_data("reproduction", "paper")
}


def scored(task: str, policy: str = "discrete_sac") -> list[float]:
    """Return the least and the largest share of the test's episodes that succeed, %."""
    shares = lasting(task, policy)
    return sorted({min(shares), max(shares)})


TUNED, AT_RANDOM = scored("station-v1", "tuned_pid"), scored("station-v1", "random")


def behind(who: str, *names: str) -> list[float]:
    """Return columns of followers with their intervals."""
    return [follow("followers", who, f"{name}{end}")[0] for name in names for end in ("", " ±")]


def stand(table: str, policy: str) -> list[float]:
    """Return how many episodes last, of how many, and the ranges of time in gait and of work."""
    (ended, num), ends = count_lasting(table, policy), list[float]()
    for name in ("in gait, %", "muscles per T"):
        ends += stretch(column("karman_gait", table, name, policy=policy))
    return [num - ended, num, *ends]


def sharp(name: str, policy: str) -> list[float]:
    return column("karman_gait", "sharp_100", name, policy=policy)


def switch(labels: str) -> list[float]:
    """Return duration with its interval, share of right labels and delay in changing streams."""
    rows = read_data("changing_streams", "steady_classifier")
    (row,) = (row for row in rows if row["labels from"] == labels)
    names = ("survival, T", "survival, T ±", "label right, %", "median delay, T")
    return [float(row[name]) for name in names if row[name] not in ("", "never")]


def station(name: str) -> list[float]:
    """Return a column at the paper's resolution, with both modules."""
    return column("karman_gait", "L100", name, label="classifier")


def caught(name: str) -> list[float]:
    rows = read_data("predation", "paper_scale")[:2]
    return [float(row[name].split()[0]) for row in rows]


BY_SKIN = find_row(PREDATION, "food on the paper's path", "50")
KINDS, HELD = "both modules", "ablation"
WITH_HISTORY = "policy's inputs, place, drift, heading"
#: By page and first cells of a row: the numbers that the rest of the row repeats.
CELLS: dict[tuple[str, ...], Callable[[], Numbers]] = {
    (RESULTS, "[Predation](tasks/predation.md), L = 50: food captured"): lambda: [
        *(*scatter(BY_SKIN[:3]), BY_SKIN[4], BY_SKIN[6], BY_SKIN[3])
    ],
    **{
        (RESULTS, f"the same, {words}, L = 64"): lambda task=task: [
            *(*scatter(lasting(task)), *scored(task, "intercept"), *scored(task, "random"), 3)
        ]
        for words, task in (
            ("paths of the food drawn", "predation-v1"),
            ("and the fish turns itself", "predation-bend-v1"),
        )
    },
    (
        RESULTS,
        "[Senses](tasks/senses.md): the fish turns itself, L = 32; episodes that last 41 T",
    ): lambda: [*scored("station-v1"), *scored("station-line-v1"), *TUNED, *AT_RANDOM, 5],
    (
        RESULTS,
        "[Changing streams](tasks/changing_streams.md), heading held, L = 32: duration, of 100 T",
    ): lambda: (
        [
            column("changing_streams", "trained", "mean survival, T", labels_from=labels)[0]
            for labels in ("memory 0.7", "PID, true label")
        ]
        + [5]
    ),
    (RESULTS, "[Two fish](tasks/several_fish.md), L = 32: food captured"): lambda: [
        float(PAIR["learned"]["food caught, %"]),
        float(PAIR["pursuit"]["food caught, %"]),
        *(6, 1),  # random actions, which are not stored, and the number of policies
    ],
    (
        RESULTS,
        "[Follower](tasks/several_fish.md), L = 32: work per distance, relative to the controller "
        "without a leader",
    ): lambda: [*behind(BEHIND[0], RELATIVE), *behind(BEHIND[1], RELATIVE), 3],
    (RESULTS, "[C-start](tasks/c_start.md), L = 192: distance in 2.7 T"): lambda: [
        *(
            column("c_start", "distances", DISTANCE, nodes_per_L="192", strokes=strokes)[0]
            for strokes in ("best", "published")
        ),
        1,
    ],
    (RESULTS, "predation: captured", "one capture"): lambda: [*caught("captured"), 32],
    (RESULTS, "time to capture, T", "14.3"): lambda: caught("time to capture"),
    (RESULTS, "survival with both modules, T", "100, 100, 100"): lambda: [
        *station("survival, T"),
        *sharp("duration, T", KINDS),
    ],
    (RESULTS, "in gait with both modules, %", "96, 87, 93"): lambda: [
        *(
            float(row["in gait (paper)"].split("%")[0])
            for row in read_data("karman_gait", "L100")[3:]
        ),
        *stretch(sharp("in gait, %", KINDS)),
    ],
    (RESULTS, "tail beat / shedding frequency", "1.00, 1.00, 1.00"): lambda: station(
        "beat / shedding"
    ),
    (RESULTS, "survival without modules, T", "6.5, 39.8, 6.1"): lambda: [
        *column("karman_gait", "L100_ablation", "survival, T"),
        *sharp("duration, T", HELD),
    ],
    **{
        (PREDATION, words, "64"): lambda arm=arm, task=task: [
            *(*lasting(task), 3, *scored(task, "intercept"), *catch(f"{arm}-pursuit")),
            *scored(task, "random"),
        ]
        for words, arm, task in (
            ("food on drawn paths, 2 levels", "turn", "predation-v1"),
            ("the same, the fish turns itself", "bend", "predation-bend-v1"),
        )
    },
    (PREDATION, "paper's path, immersed boundary", "50"): lambda: [
        *column("predation", "small", "learned, %"),
        3,
        *(
            column("predation", "small", f"{who}, %")[0]
            for who in ("intercept", "pursuit", "random")
        ),
    ],
    (PREDATION, "the same", "100"): lambda: [*caught("captured"), 2, 94],
    **{
        (SEVERAL, "`predation_pair`", name): lambda row=row: [
            float(row[key]) for key in ("episodes", "food caught, %", "contact, %")
        ]
        for name, row in zip(("learned, 1 seed", "*pursuit*"), PAIR.values(), strict=True)
    },
    **{
        (SEVERAL, *cells): lambda who=who, num=num: [
            num,
            *(behind(who, "survived 40 T, %", RELATIVE)[:2]),
            0,
            *behind(who, RELATIVE),
        ]
        for cells, who, num in (
            (("`follower`", "learned, 3 seeds"), BEHIND[0], 48),
            (("`follower`", "*keep_place*"), BEHIND[1], 16),
            (("`follower`, no leader", "learned, 3 seeds"), "mean of 3 policies, alone", 48),
            (("`follower`, no leader", "*keep_place*"), "`keep_place`, alone", 16),
        )
    },
    **{
        (CHANGING, said): lambda labels=labels, num=num: [num, *switch(labels)]
        for said, labels, num in (
            *((name, name, 3) for name in ("true label", "memory 1, no forgetting")),
            *((name, name, 3) for name in ("current signal only", "always the middle flow")),
            ("memory 0.7 (default)", "memory 0.7", 3),
            ("none: ablation", "ablation", 1),
            ("true label: PID controller", "pid", 1),
        )
    },
    **{
        (GAIT, size, policy): lambda table=table, kind=kind, seeds=seeds: [
            seeds,
            *stand(table, kind),
        ]
        for size, table, seeds in (("64", "sharp_64", 2), ("100", "sharp_100", 1))
        for policy, kind in (("with both", KINDS), ("without both", HELD))
    },
    **{
        (SENSES, *cells): lambda arm=arm: [
            *astuple(find_mean(learned(arm)[0])),
            *(choose(learned(arm)[1]) for choose in (min, max)),
        ]
        for *cells, arm in (
            ("place, drift, heading", "policy's inputs", "sight-unit"),
            ("lateral line", "all senses, last 4 observations", "line-sees-unit-no-history"),
            ("lateral line", WITH_HISTORY, "line-sees-unit"),
            ("lateral line", "policy's inputs", "line-symmetric-unit"),
            ("–", WITH_HISTORY, "own-sees-unit"),
        )
    },
}
#: First cells of rows on the page of results whose data are not stored.
UNSTORED = (
    "[Kármán gait](tasks/karman_gait.md)",  # text of studies/karman_gait/README.md
    "our classifier's accuracy",  # text of studies/reproduction/data/paper.csv
    *("`small`", "`half`", "`paper`"),  # what experiments/reproduce runs
    *("policy", "quantity"),  # meaning of a column, head
)


def find_cells(page: str, *cells: str) -> list[str]:
    """Return the numbers, as they are written, of the only row with these first cells."""
    start = "".join(f"| {cell} " for cell in cells) + "|"
    lines = (DOCS / page).read_text(encoding="utf-8").splitlines()
    (row,) = (line.removeprefix(start) for line in lines if line.startswith(start))
    return [number.replace("−", "-") for number in re.findall(NUMBER, row)]
