"""Train and score the arms of ``plan.md``.

    export PYTHONPATH=.
    python studies/drawn_paths/paths.py train --arm turn-1 --seed 0    # continues a run
    python studies/drawn_paths/paths.py score --arm turn-1 --seed 0
    python studies/drawn_paths/paths.py score --arm turn-intercept     # turn-pursuit, bend-intercept, ...
    python studies/drawn_paths/paths.py table                          # of what is scored

Seeds 0 to 2 of ``turn-4`` and all of ``bend-4`` are rows of the benchmark as well, which its own
``runs.py`` adds to the page, from the same run folders.
"""

import argparse
import json
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import torch

from fishrl.benchmark import find_version
from fishrl.envs import Flows, run_episodes
from fishrl.programs.statistics import find_mean
from fishrl.training import Plan, Training, complete, open_run
from fishrl.training.evaluation import fixed_starts
from fishrl.training.policies import prepare
from studies.benchmark.runs import make_plan

TASKS = {"turn": "predation-v1", "bend": "predation-bend-v1"}
ARMS, CONTROLLERS = ("turn-4", "turn-1", "bend-4", "bend-1"), ("intercept", "pursuit")
SCORES, NUM_STARTS, SEED = Path(__file__).parent / "data", 96, 7
#: Settings of the paths beyond those of training.
HELD_OUT = {"tilted": {"food_tilt_degrees": (20.0, 40.0)}, "faster": {"food_speed_bl": (0.4, 0.5)}}
SETS = ("as trained", *HELD_OUT)


def plan_arm(arm: str, seed: int) -> Plan:
    """Return the plan of an arm: with four observations the benchmark's."""
    kind, num_stacked = arm.split("-")
    plan = make_plan(TASKS[kind], "discrete_sac", seed)
    if plan.task.num_stacked == int(num_stacked):
        return plan
    task = replace(plan.task, num_stacked=int(num_stacked))
    return replace(plan, task=task, folder="runs/drawn_paths", name=f"{arm}-{seed}")


def train(arm: str, seed: int) -> None:
    """Train an arm to its end, or continue it."""
    opened = open_run(plan_arm(arm, seed))
    if opened.summary is None:
        complete(Training(opened))


def score(arm: str, seed: int) -> None:
    """Score the last policy of a run, or a controller, on each set, and store which were caught."""
    kind, name = arm.split("-")
    task, starts = find_version(TASKS[kind]).hold_out("test")
    policy: str | Path = name
    if arm in ARMS:
        plan = plan_arm(arm, seed)
        policy, task = Path(plan.folder) / plan.name, plan.task
    results = {}
    for paths in SETS:
        own = replace(task, **HELD_OUT.get(paths, {}))
        if paths in HELD_OUT:
            starts = fixed_starts(own, NUM_STARTS, seed=SEED)
        env, act = prepare(policy, task=own, flows=Flows(num_envs=16))
        with closing(env):
            found = run_episodes(env, act, starts)
        results[paths] = found.succeeded.tolist()
        print(arm, seed, paths, f"{found.succeeded.float().mean():.1%}", flush=True)
    SCORES.mkdir(exist_ok=True)
    (SCORES / f"{arm}-{seed}.json").write_text(json.dumps(results))


def read_shares(arm: str, paths: str) -> dict[str, float]:
    """Return the caught shares of an arm by seed, %."""
    files = sorted(SCORES.glob(f"{arm}-[0-9].json"))
    return {f.stem: 100.0 * sum(own := json.loads(f.read_text())[paths]) / len(own) for f in files}


def table() -> None:
    """Print the shares of each arm, and what four observations add, paired by seed, in points."""
    print("| arm |", " | ".join(SETS), "|")
    for arm in (*ARMS, *(f"{kind}-{name}" for kind in TASKS for name in CONTROLLERS)):
        cells = []
        for paths in SETS:
            shares = [*read_shares(arm, paths).values()]
            mean = f"{find_mean(shares).show('.3g')}: " if len(shares) > 1 else ""
            cells.append(mean + ", ".join(f"{share:.1f}" for share in shares))
        print(f"| `{arm}` |", " | ".join(cells), "|")
    for kind in TASKS:
        for paths in SETS:
            four, one = (read_shares(f"{kind}-{num}", paths) for num in (4, 1))
            seeds = [name[-1] for name in four if f"{kind}-1-{name[-1]}" in one]
            gains = [four[f"{kind}-4-{seed}"] - one[f"{kind}-1-{seed}"] for seed in seeds]
            if len(gains) > 1:
                print(f"{kind}, {paths}: 4 less 1 {find_mean(gains).show('.3g')}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("what", choices=("train", "score", "table"))
    parser.add_argument("--arm", default="turn-4")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    torch.set_num_threads(1)
    if options.what == "table":
        table()
    else:
        {"train": train, "score": score}[options.what](options.arm, options.seed)
