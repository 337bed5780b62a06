"""Does knowing the stream help a fish that does not know its place? Students of ``zoo/gait_bend``.

    PYTHONPATH=. python studies/four_arms/recognition.py

Each is taught in three streams and tried from 24 starts for 40 T there and in two it was not taught
in, with the true label of its stream, or of the nearest that it was taught in. Rows that
``data/recognition.csv`` has are not run again.
"""

import csv
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

from examples.imitate import Budget, Lesson
from fishrl.envs import KarmanGait
from fishrl.training import evaluate
from fishrl.training.policies import Policy
from fishrl.zoo import load_policy

TABLE = Path(__file__).parent / "data/recognition.csv"
TAUGHT, UNSEEN = (0.4, 0.45, 0.5), (0.42, 0.45, 0.48)  # L/T; of these the first and the last
ARMS: dict[str, tuple[Any, ...]] = {
    "own motion": ("own_motion",),
    "own motion, label": ("own_motion", "flow_label"),
    "own motion, lateral line": ("own_motion", "lateral_line"),
    "own motion, lateral line, label": ("own_motion", "lateral_line", "flow_label"),
}
SEEDS, EPISODES, PERIODS = (0, 1), 24, 40


def try_out(policy: Policy, task: KarmanGait, recognition: str | None) -> dict[str, str]:
    """Return how many episodes last, and how long, in the streams taught and in others."""
    found = {}
    for name, speeds, flows in (("taught", TAUGHT, (0, 1, 2)), ("unseen", UNSEEN, (0, 2))):
        stream = replace(task.stream, speeds_bl=speeds)
        task = replace(task, stream=stream, start_flows=flows, time_limit=8 * PERIODS + 1)
        result = evaluate(policy, task=task, recognition=recognition, episodes=EPISODES)
        found[f"{name}: last 40 T, of {EPISODES}"] = f"{EPISODES * result['success_rate']:.0f}"
        found[f"{name}: duration, T"] = f"{result['mean_length_T']:.1f}"
    return found


def main() -> None:
    """Append the rows that the table lacks."""
    rows = []
    if TABLE.exists():
        with TABLE.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
    done = {(row["observed"], row["seed"]) for row in rows}
    teacher, task = load_policy("gait_bend")
    for seed, arm in [("", "teacher: place, drift, heading, own motion"), *product(SEEDS, ARMS)]:
        if (arm, str(seed)) in done:
            continue
        row: dict[str, Any] = {"observed": arm, "seed": seed, "decisions": ""}
        if arm in ARMS:
            lesson = Lesson("gait_bend", ARMS[arm], Budget(seed=int(seed)), TAUGHT)
            row["decisions"] = lesson.give()[-1][0]
            row |= try_out(lesson.policy, lesson.task, lesson.recognition)
        else:
            assert isinstance(task, KarmanGait)
            row |= try_out(teacher, task, None)
        rows.append(row)
        with TABLE.open("w", newline="", encoding="utf-8") as file:
            table = csv.DictWriter(file, list(row), lineterminator="\n")
            table.writeheader()
            table.writerows(rows)


if __name__ == "__main__":
    main()
