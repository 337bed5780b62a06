"""Greedy policies of the four arms from the fixed starts, as trained and in other conditions.

    python studies/four_arms/greedy.py sight all line own
    python studies/four_arms/greedy.py line all --seeds 0 --condition "lateral line silent"
    python studies/four_arms/greedy.py pid --seeds 0 --condition "no disc"
    python studies/four_arms/greedy.py pid --seeds 0 --condition "no disc, L = 48"
    python studies/four_arms/greedy.py sight --seeds 1 2 --condition "L = 48"

Every policy is a row of ``data/greedy.json`` in each condition; rows that exist are not run again.
The episodes are kept in ``runs/four_arms``; ``--draw`` draws where the noses were from
those there, and writes ``data/behaviour.csv``, the means over seeds.
"""

import argparse
import csv
import json
from collections import defaultdict
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from statistics import mean, stdev
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import torch
from matplotlib.patches import Wedge

from fishrl.envs import KarmanGait
from fishrl.modules import make_actor
from fishrl.programs.gait.diagnostics import diagnose
from fishrl.programs.gait.trials import Trial, list_shedding, record
from fishrl.training.baselines import make_baseline
from fishrl.training.evaluation import FINAL_SEED, fixed_starts
from fishrl.training.policy_spec import PolicySpec
from fishrl.training.progress import Progress
from fishrl.zoo import load_policy

FOLDER = Path(__file__).parent
SIGHT = ("place", "drift", "heading")
OBSERVES = {
    "sight": (*SIGHT, "own_motion"),
    "all": (*SIGHT, "own_motion", "lateral_line"),
    "line": ("own_motion", "lateral_line"),
    "own": ("own_motion",),
}
NAMES = {
    "sight": "place, drift, heading",
    "all": "place, drift, heading, lateral line",
    "line": "lateral line",
    "own": "–",
    "pid": "hand-crafted `pid`, not tuned",
}
#: Starts, the first of them on the finer grid and without a disc, and duration in T.
EPISODES, FEW, PERIODS = 24, 6, 40
KEPT, ROWS = Path("runs/four_arms"), FOLDER / "data/greedy.json"
#: Of ``diagnose``; besides them the share of the time beside the street and near the disc.
KEYS = ("survival_T", "survivors", "diverged", "x_mean", "frequency", "frequency_over_shedding")
KEYS += ("in_street", "phase_lock", "angle_mean", "angle_max", "work", "positive_work")


def make_task(arm: str, condition: str) -> KarmanGait:
    """Return the task of an arm in the wider area: as trained, or in one of the conditions above."""
    _, task = load_policy("gait_bend")
    assert isinstance(task, KarmanGait)
    stream, line = task.stream, task.lateral_line
    if condition == "lateral line silent":
        line = replace(line, silence=1.0)
    elif condition.startswith("no disc"):
        stream = replace(stream, has_disc=False)
        row = tuple(0.25 * step for step in range(1, 13))  # up to twice the beats of the policies
        task = replace(
            task,
            control=replace(task.control, beat=replace(task.control.beat, rows=(row,))),
            checks_per_action=8,
        )
    return replace(
        task,
        body_length=48 if condition.endswith("L = 48") else 32,
        observes=OBSERVES.get(arm, OBSERVES["sight"]),
        stream=stream,
        lateral_line=line,
        safe_area=replace(task.safe_area, aside_bl=1.15),
        time_limit=8 * PERIODS + 1,
    )


def make_policy(arm: str, seed: int, task: KarmanGait) -> torch.nn.Module:
    """Return the policy of an arm and seed."""
    weights = torch.load(FOLDER / "data/weights.pt")[f"{arm}-{seed}"]
    actor = make_actor(**PolicySpec.for_task(task).sizes)
    actor.load_state_dict({name: value.float() for name, value in weights.items()})
    return actor


def run(arm: str, seed: int, condition: str, progress: Progress) -> dict[str, Any]:
    """Return one row of the table."""
    task = make_task(arm, condition)
    name = f"{arm}-{seed}, {condition}"
    if arm == "pid":
        act = partial(make_baseline, "pid", task=task, seed=seed)
    else:
        act = partial(make_policy, arm, seed, task)
    trial = Trial(name=name, arm=arm, task=task, make_policy=act, identity=name)
    num = FEW if "L = 48" in condition or "no disc" in condition else EPISODES
    histories = record(trial, fixed_starts(task, num, seed=FINAL_SEED), progress=progress)
    numbers = diagnose(histories, task, shedding_frequency=list_shedding(task)[0])
    x, y = histories.place[:, 1:, 0], histories.place[:, 1:, 1].abs()
    is_known = ~x.isnan()
    numbers["beside"] = float((y > 0.5)[is_known].double().mean())
    numbers["near"] = float((x < 1.0)[is_known].double().mean())
    KEPT.mkdir(parents=True, exist_ok=True)
    torch.save({"place": histories.place}, KEPT / f"{name}.pt")
    return {
        "arm": arm,
        "seed": seed,
        "condition": condition,
        **{key: float(f"{numbers[key]:.4g}") for key in (*KEYS, "beside", "near")},
    }


def read_rows() -> list[dict[str, Any]]:
    """Return the rows of all policies that have been run."""
    return json.loads(ROWS.read_text(encoding="utf-8")) if ROWS.exists() else []


COLUMNS = {  # of the table: entry, factor
    "duration, T": ("survival_T", 1),
    "lasts 40 T, %": ("survivors", 100),
    "x, L": ("x_mean", 1),
    "beside the street, %": ("beside", 100),
    "beats per T": ("frequency", 1),
    "pushing work per T": ("positive_work", 1),
}


def summarise() -> None:
    """Write means over seeds, with the standard deviation of the duration."""
    groups = defaultdict(list)
    for row in read_rows():
        groups[row["arm"], row["condition"]].append(row)
    order = [*OBSERVES, "pid"]
    rows = []
    for (arm, condition), found in sorted(groups.items(), key=lambda item: order.index(item[0][0])):
        row = {"policy": NAMES[arm], "condition": condition, "seeds": len(found)}
        for name, (key, factor) in COLUMNS.items():
            values = [factor * each[key] for each in found]
            digits = 3 if "work" in name else 0 if "%" in name else 2 if "x" in name else 1
            row[name] = f"{mean(values):.{digits}f}"
            if name == "duration, T":
                row[f"{name} ±"] = f"{stdev(values):.1f}" if len(values) > 1 else ""
        rows.append(row)
    with (FOLDER / "data/behaviour.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        table.writeheader()
        table.writerows(rows)


def draw() -> None:
    """Draw the share of time that the noses of each arm spend at each place, as trained."""
    figure, panels = plt.subplots(2, 2, figsize=(8, 4.6), sharex=True, sharey=True)
    figure.set_layout_engine("constrained")
    for axes, (arm, senses) in zip(panels.flat, OBSERVES.items(), strict=True):
        files = sorted(KEPT.glob(f"{arm}-*, as trained.pt"))
        places = torch.cat([torch.load(file)["place"].flatten(0, 1) for file in files])
        x, y = places[~places[:, 0].isnan()].numpy().T
        bins = (np.arange(0.3, 3.05, 0.1), np.arange(-1.2, 1.25, 0.1))
        axes.hist2d(x, y, bins=bins, weights=np.full(len(x), 100 / len(x)), cmap="Blues", vmax=5)
        axes.add_patch(Wedge((0, 0), 0.2, 90, 270, color="#444444"))
        axes.set(xlim=(-0.4, 3.1), ylim=(-1.2, 1.2), aspect="equal")
        axes.set_title(", ".join(sense.replace("_", " ") for sense in senses), fontsize=9)
    figure.supxlabel("x behind the flat side, L", fontsize=9)
    figure.supylabel("y, L", fontsize=9)
    bar = figure.colorbar(panels[0, 0].collections[0], ax=panels, shrink=0.8)
    bar.set_label("share of time in a cell of 0.1 L, %")
    figure.savefig(FOLDER / "places.png", dpi=110)


def main() -> None:
    """Append the rows that the table lacks, or draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("arms", nargs="*", metavar="arm", help="sight, all, line, own or pid")
    parser.add_argument("--draw", action="store_true")
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2, 3, 4])
    parser.add_argument("--condition", default="as trained")
    options = parser.parse_args()
    if options.draw:
        summarise()
        return draw()
    rows = read_rows()
    done = {(row["arm"], row["seed"], row["condition"]) for row in rows}
    with Progress() as progress:
        for seed, arm in product(options.seeds, options.arms):
            if (arm, seed, options.condition) not in done:
                rows.append(run(arm, seed, options.condition, progress))
                lines = ",\n".join(json.dumps(row) for row in rows)
                ROWS.write_text(f"[\n{lines}\n]\n", encoding="utf-8")


if __name__ == "__main__":
    main()
