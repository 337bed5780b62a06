"""Conclusions in words, and what holds if they are right."""

from collections.abc import Callable
from math import log2
from statistics import fmean

from scipy import stats

from studies import claims
from studies.tables import read_data
from tests.docs.page_numbers import (
    ALGORITHMS,
    BEHIND,
    BODY,
    C_START,
    CHANGING,
    DISTANCE,
    EXTRAPOLATED,
    GAIT,
    OWN,
    PREDATION,
    PRINTED,
    RELATIVE,
    RESOLUTION,
    RESULTS,
    SEEN,
    SENSE,
    SENSES,
    SEVERAL,
    SPEED,
    STREAM,
    arm,
    column,
    count_lasting,
    find_row,
    find_rows,
    follow,
    forces,
    gain,
    is_above,
    last,
    measured,
    off,
    overlap,
    read,
    taught,
)

#: Page, what it concludes, and whether its numbers say so.
HELD: list[tuple[str, str, Callable[[], bool]]] = [
    (
        STREAM,
        "Released, the anguilliform fish would swim upstream, the carangiform one, whose tail moves"
        " less, drift downstream.",
        lambda: forces(PRINTED)[0] < 0.0 < forces(PRINTED)[1],
    ),
    (
        STREAM,
        "The immersed boundary keeps the order but not the sign",
        lambda: 0.0 < forces("not the sign: # and #")[0] < forces("not the sign: # and #")[1],
    ),
    (
        RESOLUTION,
        "Resolve an obstacle by 20 nodes (drag within 1 %",
        lambda: all(
            abs(off(measured("channel-cylinder", f"C_d{of}", "D = 20"), reference)) < 1.0
            for of, reference in ((", Re = 20", 5.5795), (",max, Re = 100", 3.23))
        ),
    ),
    (
        BODY,
        "20 nodes across the body give the drag within 1 %",
        lambda: abs(off(measured("channel-cylinder", "C_d, Re = 20", "D = 20"), 5.5795)) < 1.0,
    ),
    (
        RESULTS,
        "**Controllers are better** in predation and behind a leader, and as good in station "
        "holding, in changing streams and with two fish.",
        lambda: (
            is_above(find_row(PREDATION, "food on the paper's path", "50"), best=4, than=slice(3))
            and follow("followers", BEHIND[1], RELATIVE) < follow("followers", BEHIND[0], RELATIVE)
            and count_lasting("station", "pid")[0] <= 1
            and overlap(CHANGING, "memory 0.7 (default)", "true label: PID controller")
            and abs(find_row(SEVERAL, "`predation_pair`", "learned, 1 seed")[1] - 80) < 5
        ),
    ),
    (
        RESULTS,
        "Policies are better at staying in gait; in the C-start a search beats the published",
        lambda: (
            "(in gait 60–95 % of the time) | 100 % (in gait 37–42 %)" in read(RESULTS)
            and gain("192", DISTANCE) > 0.0
        ),
    ),
    (
        RESULTS,
        "**Modules are rarely necessary.** The paper's fish fails without lateral line",
        lambda: (
            max(map(float, read_data("reproduction", "small")[1]["paper"].split(", "))) < 40.0
            and count_lasting("station", "ablation")[0] < 0.15 * 306
            and count_lasting("sharp_64", "ablation")[0] < 0.5 * 36
        ),
    ),
    (
        RESULTS,
        "though the lateral line doubles their time",
        lambda: 1.75 < arm("lateral line") / arm("nothing") < 2.5,
    ),
    (
        RESULTS,
        "**Learned labels do not prolong survival** in changing streams, and no policy outlasts "
        "the PID controller under nine new conditions",
        lambda: (
            overlap(CHANGING, "memory 0.7 (default)", "none: ablation")
            and len({row["condition"] for row in read_data("robustness", "conditions")}) == 10
            and max(column("robustness", "conditions", "beyond pid, T low")) <= 0.0
        ),
    ),
    (
        RESULTS,
        "At L = 64 the larger Mach number alone makes policies fail with and without modules",
        lambda: all(
            (float(row["survival at 1, 1.25, 1.5 L/T, T"].split(", ")[2]) < 50)
            == (row["evaluated at Mach"] == "0.26")
            for row in read_data("karman_gait", "mach")
        ),
    ),
    (
        RESULTS,
        "are smaller than ours, which leave out the work of the torque",
        lambda: all(
            float(row["paper's ratio"]) < float(row["lateral: ratio"])
            for row in read_data("karman_gait", "work")
        ),
    ),
    (
        RESOLUTION,
        "Random turns of ±15° at Re = 7000 never diverged at L = 50 and 100.",
        lambda: all(
            measured("stability", f"share of diverged episodes, {of}") == 0.0
            for of in ("small, L = 50", "paper, L = 100")
        ),
    ),
    (
        C_START,
        "grows at first order towards 1.35 L",
        lambda: (
            0.8 < log2((1.0931 - 0.78992) / (1.2326 - 1.0931)) < 1.2
            and round(measured("c-start", EXTRAPOLATED), 2) == 1.35
        ),
    ),
    (
        CHANGING,
        "no source of labels changes how long the fish lasts.",
        lambda: overlap(
            CHANGING,
            *("true label", "memory 0.7 (default)", "memory 1, no forgetting"),
            *("current signal only", "always the middle flow", "none: ablation"),
        ),
    ),
    (
        CHANGING,
        "Without it, the label is right less often than a constant one.",
        lambda: (
            find_row(CHANGING, "memory 1, no forgetting")[3]
            < find_row(CHANGING, "always the middle flow")[3]
        ),
    ),
    (
        CHANGING,
        "**The goal is missed:** to recognise 95 % of the changes within 2 T.",
        lambda: claims.check_changing_streams() is None,
    ),
    (
        SEVERAL,
        "two fish that share one policy catch food about as often as two hand-crafted pursuers.",
        lambda: stats.fisher_exact([[76, 20], [77, 19]]).pvalue > 0.5,
    ),
    (
        SEVERAL,
        "Alone in the same stream the learned policies need as much work as *keep_place*, so their "
        "saving comes from the wake.",
        lambda: claims.check_following() is None,
    ),
    (
        SENSES,
        "A blind one does as well with its lateral line, once it imitates the first",
        lambda: min(last("imitation", SENSE)) >= 17 > 18 - 2 and max(last("imitation", OWN)) <= 2,
    ),
    (
        SENSES,
        "learning then equals a tuned controller",
        lambda: min(find_row(SENSES, "SAC", "place, drift, heading, own motion")[2:]) > 28.0,
    ),
    (
        SENSES,
        "a blind fish that imitates lasts as long as its teacher",
        lambda: taught("own motion, lateral line") > 0.95 * taught("teacher: " + SEEN),
    ),
    (
        SENSES,
        "is neither enough nor needed.",
        lambda: taught("own motion, label") < 0.5 * taught("own motion, lateral line"),
    ),
    (
        GAIT,
        "for a net work of nearly zero",
        lambda: (
            max(map(abs, find_row(GAIT, "32", "with classifier and macro-actions")[-2:]))
            < min(find_row(GAIT, "32", "without both (ablation)")[-2:])
        ),
    ),
    (
        GAIT,
        "falls back in fast streams at L = 64 and 100",
        lambda: all(
            row["1.5"] < row["1"]
            for table in ("sharp_64", "sharp_100")
            for row in [
                {
                    stream: fmean(
                        column(
                            "karman_gait",
                            table,
                            "duration, T",
                            policy="ablation",
                            **{"stream,_L/T": stream},
                        )
                    )
                    for stream in ("1", "1.5")
                }
            ]
        ),
    ),
    (
        GAIT,
        "takes more energy from the fish than the muscles exchange net",
        lambda: all(
            -torque > abs(muscles)
            for muscles, _, torque, _ in (
                find_row(GAIT, "`gait_narrow`, L = 64", "1"),
                *(rows[1] for rows in (find_rows(GAIT, "", "1.25"), find_rows(GAIT, "", "1.5"))),
            )
        ),
    ),
    (
        ALGORITHMS,
        "SAC converges significantly faster than DRQN; its lead over DQN and double DQN is not "
        "significant.",
        lambda: claims.check_algorithms() is None,
    ),
    (
        SPEED,
        "all are missed by a little, but 2.8 for step / collision of `gait_bend` is met.",
        lambda: (
            find_row(SPEED, "gait_bend, 192 × 96", "now")[6] <= 2.8
            and all(
                goal < find_row(SPEED, case, "now")[7] < 1.25 * goal
                for case, goal in (
                    ("gait_bend, 192 × 96", 0.23),
                    ("gait_small, 320 × 160", 0.35),
                    ("small, 500 × 250", 0.53),
                )
            )
        ),
    ),
    (
        SPEED,
        "Both goals are missed.",
        lambda: (
            find_row(SPEED, "collision alone")[-1] > find_row(SPEED, "collision alone")[-2]
            and (lambda row: row[-1] > row[-2])(
                find_row(SPEED, "with a fish in each, immersed boundary")
            )
        ),
    ),
]
