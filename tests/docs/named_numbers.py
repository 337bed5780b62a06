"""Conclusions that name numbers, and what these follow from."""

import re
from collections.abc import Callable
from statistics import fmean

from scipy import stats

from experiments.benchmarks.accuracy import extrapolate
from studies.tables import read_data
from tests.docs.page_numbers import (
    BEHIND,
    BODY,
    C_START,
    CHANGING,
    DISTANCE,
    DOCS,
    FAST,
    GAIT,
    PREDATION,
    README,
    RELATIVE,
    RESOLUTION,
    RESULTS,
    SEVERAL,
    SPEED,
    STREAM,
    WORK,
    Numbers,
    column,
    compare,
    count_lasting,
    find,
    find_line,
    find_row,
    follow,
    gain,
    list_verdicts,
    measured,
    off,
    scatter,
    swim,
    swim_blurred,
    swum,
)

#: Page, what it concludes, and the numbers that it should name.
NAMED: list[tuple[str, str, Callable[[], Numbers]]] = [
    (
        RESOLUTION,
        "#, #, #, # and # % below the limit",
        lambda: [
            -off(speed, extrapolate(*list(swum().values())[-3:])) for speed in swum().values()
        ],
    ),
    (
        RESOLUTION,
        "speed at L = 100 by # %, mean drag at D = 20 by # % and lift amplitude by # %",
        lambda: [
            off(measured("compressibility", f"{what}: default speed / half of it"), 1.0)
            for what in (
                "swimming speed, L = 100",
                "mean drag of the cylinder",
                "lift of the cylinder",
            )
        ],
    ),
    (
        RESOLUTION,
        "lift amplitude # % low",
        lambda: [
            -off(
                measured("channel-cylinder", "C_l,max, Re = 100", "D = 20"),
                measured("channel-cylinder", "C_l,max, Re = 100"),
            )
        ],
    ),
    (
        BODY,
        "the two drags differ by # %",
        lambda: [off(*map(float, find(BODY, "drag #, lift 0.446; immersed boundary #")))],
    ),
    (
        RESULTS,
        "a fish of 32 nodes swims at # to # of its converged speed and one of 50 nodes at # to #",
        lambda: [swim(length, column) for length in (32, 50) for column in (1, 0)],
    ),
    (
        RESULTS,
        "with the immersed boundary at # and at #",
        lambda: [swim_blurred(32), swim_blurred(50)],
    ),
    (RESULTS, "diverged (below # % with", lambda: [100.0 * (1.0 - 0.05 ** (1 / 512))]),
    (
        RESULTS,
        "Ours fails then in # of # episodes at L = 64 and # of # at L = 100",
        lambda: [*count_lasting("sharp_64", "ablation"), *count_lasting("sharp_100", "ablation")],
    ),
    (
        RESOLUTION,
        "adds # %, # % and # % and halves",
        lambda: [
            off(FAST[what]["0.14 nodes per step"], FAST[what]["0.07 nodes per step"])
            for what in ("swim", "drag", "lift")
        ],
    ),
    (
        RESOLUTION,
        "which is itself # % (Re = 500) to # % (Re = 7142) slower than the limit",
        lambda: [100.0 * (1.0 - swim(100, column)) for column in (0, 1)],
    ),
    (
        C_START,
        "covers # body lengths in 2.7 T on the finest grid, # % more than in the authors' code",
        lambda: [
            measured("c-start", "distance after 2.7 T, L"),
            off(measured("c-start", "distance after 2.7 T, L"), 1.15),
        ],
    ),
    (
        C_START,
        "carry it # % farther on that grid, with # % less work",
        lambda: [gain("192", DISTANCE), -gain("192", WORK)],
    ),
    (
        C_START,
        "as the grid is refined: #, # and # % more distance with #, # and # % less work",
        lambda: [
            *(gain(grid, DISTANCE) for grid in ("48", "96", "192")),
            *(-gain(grid, WORK) for grid in ("48", "96", "192")),
        ],
    ),
    (
        CHANGING,
        "recognises # % of the time",
        lambda: [find_row(CHANGING, "current signal only")[3]],
    ),
    (
        CHANGING,
        "both modules last # T longer than five without",
        lambda: [
            column("changing_streams", "trained", "mean survival, T", labels_from="memory 0.7")[0]
            - column("changing_streams", "trained", "mean survival, T", labels_from="ablation")[0]
        ],
    ),
    (
        SEVERAL,
        "learned policies need # of the work per distance that a hand-crafted controller needs "
        "without a leader, and the controller itself # of it",
        lambda: [follow("followers", who, RELATIVE)[0] for who in BEHIND],
    ),
    (
        SEVERAL,
        "exploits it better: it settles # L behind the leader, where the work is least, the "
        "learned ones at # to # L",
        lambda: [
            follow("followers", BEHIND[1], "mean x, L")[0],
            min(follow("followers", "seed", "mean x, L")[:3]),
            max(follow("followers", "seed", "mean x, L")[:3]),
        ],
    ),
    (
        SEVERAL,
        "learned ones were ahead, # against #",
        lambda: [follow("immersed", who, RELATIVE)[0] for who in BEHIND],
    ),
    (
        SEVERAL,
        "contact may be chance (p = #, Fisher's exact test)",
        lambda: [stats.fisher_exact([[11, 96 - 11], [18, 96 - 18]]).pvalue],
    ),
    (
        SEVERAL,
        "the follower swims # % slower than at L = 100, for # % more power",
        lambda: [
            sign * float(number.replace("−", "-"))
            for sign, number in zip(
                (-1, 1), re.findall(r"[−+]\d+(?= %)", find_line("`follower_small`")), strict=True
            )
        ],
    ),
    (
        GAIT,
        "they beat at # to # times that frequency and are in gait for # % of the time",
        lambda: [
            min(column("karman_gait", "station", "beat / shedding", policy="both modules")),
            max(column("karman_gait", "station", "beat / shedding", policy="both modules")),
            fmean(column("karman_gait", "station", "in gait, %", policy="both modules")),
        ],
    ),
    (
        GAIT,
        "all # episodes last and are always in gait",
        lambda: [sum(column("karman_gait", "L100", "episodes", label="classifier"))],
    ),
    (
        PREDATION,
        "between the skins** (# ± # against # ± # %) is within the scatter of three seeds",
        lambda: [
            *scatter(find_row(PREDATION, "food on the paper's path", "50")[:3]),
            *scatter(column("predation", "small", "learned, %")),
        ],
    ),
    (
        PREDATION,
        "A memory of four observations adds # points to one of the latest alone, 95 % interval "
        "[#, #]: not resolved",
        lambda: compare(
            *(
                [float(row["captured of 96, %"]) for row in read_data("predation", "memory")][part]
                for part in (slice(5), slice(5, 10))
            )
        ),
    ),
    (
        PREDATION,
        "from # ± # % (interception # %), and from # ± # % if it is faster (# %)",
        lambda: [
            number
            for name in ("tilted more, % of 96", "faster, % of 96")
            for number in (
                *scatter(column("predation", "held_out", name, policy="learned, 4 observations")),
                column("predation", "held_out", name, policy="interception, which knows the path")[
                    0
                ],
            )
        ],
    ),
    (
        CHANGING,
        "with which a fish of 32 nodes swims at # of its converged speed",
        lambda: [swim_blurred(32)],
    ),
    (
        README,
        "# cases against exact solutions and published results; # of # acceptance criteria are met",
        lambda: [
            len(list(DOCS.glob("validation/*.json"))),
            sum(verdict == "pass" for verdict in list_verdicts()),
            sum(verdict != "recorded" for verdict in list_verdicts()),
        ],
    ),
    (
        README,
        "takes # µs and a tail beat # s (192 × 96 nodes), at L = 50 in the tank # s, at L = 100 "
        "with the paper's immersed boundary # s",
        lambda: [
            find_row(SPEED, "gait_bend, 192 × 96", "now")[0],
            *(
                find_row(SPEED, case, "now")[-1]
                for case in ("gait_bend, 192 × 96", "small, 500 × 250", "paper, 1000 × 500")
            ),
        ],
    ),
    (STREAM, "= # N per metre of depth", lambda: [1000 * 0.04**3 * 3**2]),
]
