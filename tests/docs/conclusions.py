"""Conclusions of pages, and the numbers they follow from."""

# ruff: noqa: F403, F405 - the tables are written in the words of page_numbers
import re
from collections.abc import Callable
from dataclasses import astuple
from math import log2
from statistics import fmean

from scipy import stats

from experiments.benchmarks.accuracy import extrapolate
from studies import claims
from studies.tables import read_data
from tests.docs.page_numbers import *

DRAG_LIFT, LIFTED = ("mean drag", "lift"), ("channel-cylinder", "C_l,max, Re = 100")
ARMS, GUIDE = (slice(5), slice(5, 10)), "interception, which knows the path"
LARGEST = "paper, 1000 × 500"
TIMED = ("L = 50, 500 × 250", LARGEST)
TRAINED = "as trained, % of 96"
MISSED = ("collision alone", "with a fish in each, immersed boundary")


def survived(labels: str) -> float:
    """Return the mean survival in changing streams, T."""
    return column("changing_streams", "trained", "mean survival, T", labels_from=labels)[0]


#: By page: what it concludes, with ``#`` for each number, and the numbers that it should name.
NAMED: dict[str, dict[str, Callable[[], Numbers]]] = {
    RESOLUTION: {
        "#, #, #, # and # % below the limit": lambda: [
            -off(speed, extrapolate(*list(swum().values())[-3:])) for speed in swum().values()
        ],
        "speed at L = 100 by # %, mean drag at D = 20 by # % and lift amplitude by # %": lambda: [
            off(measured("compressibility", f"{what}: default speed / half of it"), 1.0)
            for what in ("swimming speed, L = 100", *(f"{x} of the cylinder" for x in DRAG_LIFT))
        ],
        "lift amplitude # % low": lambda: [-off(measured(*LIFTED, "D = 20"), measured(*LIFTED))],
        "adds # %, # % and # % and halves": lambda: [
            off(case["0.14 nodes per step"], case["0.07 nodes per step"]) for case in FAST.values()
        ],
        "which is itself # % (Re = 500) to # % (Re = 7142) slower than the limit": lambda: [
            100.0 * (1.0 - swim(100, column)) for column in (0, 1)
        ],
    },
    SENSES: {
        "it falls short by # T [#, #] of 40 T, # T [#, #] of 100 T and, in the "
        "[benchmark](../benchmark.md), # T of 41 T": lambda: [
            *astuple(differ("sight-unit", "line-sees-unit-no-history")),
            *astuple(differ("sight-unit", "line-sees-unit-no-history", starts="test-100-T")),
            score("station-v1") - score("station-line-v1"),
        ],
        "read what the policy reads cost # T compared with those that see": lambda: [
            differ("line-sees-unit", "line-symmetric-unit").value
        ],
    },
    BODY: {
        "the two drags differ by # %": lambda: [
            off(*map(float, find(BODY, "drag #, lift 0.446; immersed boundary #")))
        ]
    },
    RESULTS: {
        "a fish of 32 nodes swims at # to # of its converged speed and one of 50 nodes at # "
        "to #": lambda: [swim(length, column) for length in (32, 50) for column in (1, 0)],
        "with the immersed boundary at # and at #": lambda: [swim_blurred(32), swim_blurred(50)],
        "diverged (below # % with": lambda: [100.0 * (1.0 - 0.05 ** (1 / 512))],
        "Without them ours fails in # of # episodes at L = 64 and # of # at L = 100": lambda: [
            *count_lasting("sharp_64", "ablation"),
            *count_lasting("sharp_100", "ablation"),
        ],
    },
    C_START: {
        "covers # body lengths in 2.7 T on the finest grid, "
        "# % more than in the authors' code": lambda: [
            *(distance := [measured("c-start", "distance after 2.7 T, L")]),
            off(*distance, 1.15),
        ],
        "carry it, with markers inset, # % farther on that grid, with # % less work": lambda: [
            gain("192", DISTANCE),
            -gain("192", WORK),
        ],
        "as the grid is refined: #, # and # % more distance with #, # and # % less work": lambda: [
            *(gain(grid, DISTANCE) for grid in ("48", "96", "192")),
            *(-gain(grid, WORK) for grid in ("48", "96", "192")),
        ],
    },
    CHANGING: {
        "recognises # % of the time": lambda: [find_row(CHANGING, "current signal only")[3]],
        "both modules last # T, # T longer than five without": lambda: [
            survived("memory 0.7"),
            survived("memory 0.7") - survived("ablation"),
        ],
        "with which a fish of 32 nodes swims at # of its converged speed": lambda: [
            swim_blurred(32)
        ],
    },
    SEVERAL: {
        "learned policies need # of the work per distance that a hand-crafted controller "
        "needs without a leader, and the controller itself # of it": lambda: [
            follow("followers", who, RELATIVE)[0] for who in BEHIND
        ],
        "exploits it better: it settles # L behind the leader, where the work is least, the "
        "learned ones at # to # L": lambda: [
            follow("followers", BEHIND[1], "mean x, L")[0],
            *stretch(follow("followers", "seed", "mean x, L")[:3]),
        ],
        "learned ones were ahead, # against #": lambda: [
            follow("immersed", who, RELATIVE)[0] for who in BEHIND
        ],
        "contact may be chance (p = #, Fisher's exact test)": lambda: [
            stats.fisher_exact([[11, 96 - 11], [18, 96 - 18]]).pvalue
        ],
        "the follower swims # % slower than at L = 100, for # % more power": lambda: [
            sign * float(number.replace("−", "-"))
            for sign, number in zip(
                (-1, 1), re.findall(r"[−+]\d+(?= %)", find_line(r"– \| follower")), strict=True
            )
        ],
    },
    GAIT: {
        "they beat at # to # times that frequency and are in gait for # % of the time": lambda: [
            *stretch(column("karman_gait", "station", "beat / shedding", policy="both modules")),
            fmean(column("karman_gait", "station", "in gait, %", policy="both modules")),
        ],
        "all # episodes last and are always in gait": lambda: [
            sum(column("karman_gait", "L100", "episodes", label="classifier"))
        ],
    },
    PREDATION: {
        "between the skins** (# ± # against # ± # %) "
        "is within the scatter of three seeds": lambda: [
            *scatter(find_row(PREDATION, "food on the paper's path", "50")[:3]),
            *scatter(column("predation", "small", "learned, %")),
        ],
        "a memory of four observations adds # points to one of the latest alone, 95 % "
        "interval [#, #]: not resolved": lambda: compare(
            *(column("predation", "memory", "captured of 96, %")[part] for part in ARMS)
        ),
        "capture the food from # ± # % of the starts (interception # %) on paths tilted more than "
        "in training, and from # ± # % if it is faster (# %); by bending from # ± # and # ± # "
        "%": lambda: [
            *(*scatter(catch("turn-4", "tilted")), *catch("turn-intercept", "tilted")),
            *(*scatter(catch("turn-4", "faster")), *catch("turn-intercept", "faster")),
            *(*scatter(catch("bend-4", "tilted")), *scatter(catch("bend-4", "faster"))),
        ],
    },
    README: {
        "# cases, # of them with criteria from published results; # of # acceptance criteria "
        "are met": lambda: [
            len(list(DOCS.glob("validation/*.json"))),
            count_published(),
            sum(verdict == "pass" for verdict in list_verdicts()),
            sum(verdict != "recorded" for verdict in list_verdicts()),
        ],
        "lasts 41 T from # to # % of # starts with sight, and from # to # % blind": lambda: [
            *(end(lasting("station-v1")) for end in (min, max)),
            96,
            *(end(lasting("station-line-v1")) for end in (min, max)),
        ],
        "takes # µs (320 × 160 nodes); a tail beat in the tank takes # s at L = 50 and # s at "
        "L = 100 with the paper's immersed boundary": lambda: [
            find_row(SPEED, "gait_small, 320 × 160")[0],
            *(find_row(SPEED, case)[-1] for case in TIMED),
        ],
    },
    SPEED: {
        "A step takes # to # of its time at e28df4c1": lambda: [
            choose(find_row(SPEED, case)[2] for case in ("gait_bend", "paper"))
            for choose in (min, max)
        ],
    },
    STREAM: {"= # N per metre of depth": lambda: [1000 * 0.04**3 * 3**2]},
}

#: By page: what it concludes in words, and whether its numbers say so.
HELD: dict[str, dict[str, Callable[[], bool]]] = {
    STREAM: {
        "Released, the anguilliform fish would swim upstream, the carangiform one, whose "
        "tail moves less, drift downstream.": lambda: forces(PRINTED)[0] < 0.0 < forces(PRINTED)[1],
        "The immersed boundary keeps the order but not the sign": lambda: (
            0.0 < forces("not the sign: # and #")[0] < forces("not the sign: # and #")[1]
        ),
    },
    RESOLUTION: {
        "Resolve an obstacle by 20 nodes (drag within 1 %": lambda: all(
            abs(off(measured("channel-cylinder", f"C_d{of}", "D = 20"), reference)) < 1.0
            for of, reference in ((", Re = 20", 5.5795), (",max, Re = 100", 3.23))
        ),
        "With the immersed boundary, random turns of ±15° at Re = 7000 never diverged": lambda: all(
            measured("stability", f"share of diverged episodes, {of}") == 0.0
            for of in ("small, L = 50", "paper, L = 100")
        ),
    },
    BODY: {
        "20 nodes across the body give the drag within 1 %": lambda: (
            abs(off(measured("channel-cylinder", "C_d, Re = 20", "D = 20"), 5.5795)) < 1.0
        )
    },
    RESULTS: {
        "**Controllers are better** in predation and behind a leader, and as good in station "
        "holding, in changing streams and with two fish.": lambda: (
            is_above(find_row(PREDATION, "food on the paper's path", "50"), best=4, than=slice(3))
            and follow("followers", BEHIND[1], RELATIVE) < follow("followers", BEHIND[0], RELATIVE)
            and count_lasting("station", "pid")[0] <= 1
            and overlap(CHANGING, "memory 0.7 (default)", "true label: PID controller")
            and abs(find_row(SEVERAL, "`predation_pair`", "learned, 1 seed")[1] - 80) < 5
        ),
        "Policies are better at staying in gait; "
        "in the C-start a search gains 6 %, less than the grid's error.": lambda: (
            "(in gait 60–95 % of the time) | 100 % (in gait 37–42 %)" in read(RESULTS)
            and round(gain("192", DISTANCE)) == 6
            and off(
                measured("c-start", EXTRAPOLATED), measured("c-start", "distance after 2.7 T, L")
            )
            > 6.0
        ),
        "**Whether modules are needed depends on grid and skin.** The paper's fish fails": lambda: (
            max(map(float, read_data("reproduction", "small")[1]["paper"].split(", "))) < 40.0
            and count_lasting("station", "ablation")[0] < 0.15 * 306
            and 0.2 * 36 < count_lasting("sharp_64", "ablation")[0] < 0.5 * 36
        ),
        "**Learned labels show no effect on survival** in changing streams; under nine new "
        "conditions no policy clearly outlasts the PID controller": lambda: (
            overlap(CHANGING, "memory 0.7 (default)", "none: ablation")
            and len({row["condition"] for row in read_data("robustness", "conditions")}) == 10
            and max(column("robustness", "conditions", "beyond pid, T low")) <= 0.0
        ),
        "At L = 64 the larger Mach number alone "
        "makes policies fail with and without modules": lambda: all(
            (float(row["survival at 1, 1.25, 1.5 L/T, T"].split(", ")[2]) < 50)
            == (row["evaluated at Mach"] == "0.26")
            for row in read_data("karman_gait", "mach")
        ),
        "are smaller than ours, which leave out the work of the torque": lambda: all(
            float(row["paper's ratio"]) < float(row["lateral: ratio"])
            for row in read_data("karman_gait", "work")
        ),
    },
    C_START: {
        "grows at first order towards 1.35 L": lambda: (
            0.8 < log2((1.0931 - 0.78992) / (1.2326 - 1.0931)) < 1.2
            and round(measured("c-start", EXTRAPOLATED), 2) == 1.35
        )
    },
    CHANGING: {
        "no effect of the labels on duration is resolved.": lambda: overlap(
            CHANGING,
            *("true label", "memory 0.7 (default)", "memory 1, no forgetting"),
            *("current signal only", "always the middle flow", "none: ablation"),
        ),
        "Without it, the label is right less often than a constant one.": lambda: (
            find_row(CHANGING, "memory 1, no forgetting")[3]
            < find_row(CHANGING, "always the middle flow")[3]
        ),
        "**The goal is missed:** to recognise 95 % of the changes within 2 T.": lambda: (
            claims.check_changing_streams() is None
        ),
    },
    SEVERAL: {
        "two fish that share one policy catch food about as "
        "often as two hand-crafted pursuers.": lambda: (
            stats.fisher_exact([[76, 20], [77, 19]]).pvalue > 0.5
        ),
        "Alone in the same stream the learned policies need as much work as *keep_place*, so "
        "their saving comes from the wake.": lambda: claims.check_following() is None,
    },
    SENSES: {
        "A blind one does as well with its lateral line, once it imitates the first": lambda: (
            min(last("imitation", SENSE)) >= 17 > 18 - 2 and max(last("imitation", OWN)) <= 2
        ),
        "**A blind fish with a lateral line lasts nearly as long as one that sees**": lambda: (
            0.0 < score("station-v1") - score("station-line-v1") < 3.0
        ),
        "learning then equals a tuned controller": lambda: (
            min(find_row(SENSES, "SAC", "place, drift, heading, own motion")[2:]) > 28.0
        ),
        "a blind imitator lasts as long as its teacher": lambda: (
            taught("own motion, lateral line") > 0.95 * taught("teacher: " + SEEN)
        ),
        "is neither enough nor needed.": lambda: (
            taught("own motion, label") < 0.5 * taught("own motion, lateral line")
        ),
    },
    GAIT: {
        "for a net work of nearly zero": lambda: (
            max(map(abs, find_row(GAIT, "32", "with classifier and macro-actions")[-2:]))
            < min(find_row(GAIT, "32", "without both (ablation)")[-2:])
        ),
        "falls back in fast streams at L = 64 and 100": lambda: all(
            lasted(table, "1.5") < lasted(table, "1") for table in ("sharp_64", "sharp_100")
        ),
        "takes more energy from the fish than the muscles exchange net": lambda: all(
            -torque > abs(muscles)
            for muscles, _, torque, _ in (
                find_row(GAIT, "`gait_narrow`, L = 64", "1"),
                *(find_rows(GAIT, "", stream)[1] for stream in ("1.25", "1.5")),
            )
        ),
    },
    ALGORITHMS: {
        "biased in theory (Baisero & Amato 2022), [better in our trial]": lambda: (
            differ("line-sees-unit-no-history", "line-sees-unit").low > 0.0
        ),
        "SAC converges significantly faster than DRQN; its lead over DQN and double DQN is "
        "not significant.": lambda: claims.check_algorithms() is None,
    },
    SPEED: {
        "Both goals are missed.": lambda: all(
            row[-1] > row[-2] for row in (find_row(SPEED, case) for case in MISSED)
        ),
    },
}
