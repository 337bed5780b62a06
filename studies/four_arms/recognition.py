"""Does knowing the stream help a fish that does not know its place? Students of ``zoo/gait_bend``.

    PYTHONPATH=. python studies/four_arms/recognition.py

Each is taught in three streams and tried from 24 starts for 40 T there and in two it was not taught
in, with the true label of its stream, or of the nearest that it was taught in. Rows that
``data/recognition.json`` has are not run again; ``data/recognition.csv`` has the means over seeds.
"""

import csv
import json
from dataclasses import replace
from itertools import product
from pathlib import Path
from statistics import mean, stdev
from typing import Any

from examples.imitate import Budget, Lesson
from fishrl.envs import KarmanGait
from fishrl.training import evaluate
from fishrl.training.policies import Policy
from fishrl.zoo import load_policy

DATA = Path(__file__).parent / "data"
TEACHER = "teacher: place, drift, heading, own motion"
ARMS: dict[str, tuple[Any, ...]] = {
    "own motion": ("own_motion",),
    "own motion, label": ("own_motion", "flow_label"),
    "own motion, lateral line": ("own_motion", "lateral_line"),
    "own motion, lateral line, label": ("own_motion", "lateral_line", "flow_label"),
}
TAUGHT = (0.4, 0.45, 0.5)  # L/T
#: Speeds, and the indices of those that are swum in.
STREAMS = {"taught": (TAUGHT, (0, 1, 2)), "new": ((0.42, 0.45, 0.48), (0, 2))}
SEEDS, EPISODES, PERIODS = (0, 1, 2, 3, 4), 24, 40


def run(arm: str, seed: int) -> dict[str, Any]:
    """Teach a student and try it, or the teacher; return how many episodes last, and how long."""
    policy: Policy
    policy, task = load_policy("gait_bend")
    row: dict[str, Any] = {"observed": arm, "seed": seed}
    recognition = None
    if arm in ARMS:
        lesson = Lesson("zoo/gait_bend", ARMS[arm], Budget(seed=seed), TAUGHT)
        row["decisions"] = lesson.give()[-1][0]
        policy, task, recognition = lesson.policy, lesson.task, lesson.recognition
    assert isinstance(task, KarmanGait)
    for name, (speeds, flows) in STREAMS.items():
        stream = replace(task.stream, speeds_bl=speeds)
        own = replace(task, stream=stream, start_flows=flows, time_limit=8 * PERIODS + 1)
        result = evaluate(policy, task=own, recognition=recognition, episodes=EPISODES)
        row[f"{name}: last"] = round(EPISODES * result["success_rate"])
        row[f"{name}: duration, T"] = round(result["mean_length_T"], 1)
    return row


def summarise(rows: list[dict[str, Any]]) -> None:
    """Write the means over seeds, with the standard deviation of the duration."""
    table = []
    for arm in (TEACHER, *ARMS):
        found = [row for row in rows if row["observed"] == arm]
        line: dict[str, Any] = {"observed": arm, "seeds": len(found)}
        for name in STREAMS:
            last = sum(row[f"{name}: last"] for row in found)
            line[f"{name}: last 40 T"] = f"{last} of {EPISODES * len(found)}"
            lasted = [row[f"{name}: duration, T"] for row in found]
            line[f"{name}: duration, T"] = f"{mean(lasted):.1f}"
            line[f"{name}: duration, T ±"] = f"{stdev(lasted):.1f}" if len(lasted) > 1 else ""
        table.append(line)
    with (DATA / "recognition.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(table[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(table)


def main() -> None:
    """Append the rows that are missing, and write the table."""
    path = DATA / "recognition.json"
    rows = json.loads(path.read_text(encoding="utf-8")) if path.exists() else []
    done = {(row["observed"], row["seed"]) for row in rows}
    for seed, arm in [(0, TEACHER), *product(SEEDS, ARMS)]:
        if (arm, seed) not in done:
            rows.append(run(arm, seed))
            lines = ",\n".join(json.dumps(row) for row in rows)
            path.write_text(f"[\n{lines}\n]\n", encoding="utf-8")
    summarise(rows)


if __name__ == "__main__":
    main()
