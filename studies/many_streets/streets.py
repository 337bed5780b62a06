"""Train and score the arms of ``plan.md``.

    export PYTHONPATH=.
    python studies/many_streets/streets.py train --arm label --seed 0    # continues a run
    python studies/many_streets/streets.py score --arm label --seed 0
    python studies/many_streets/streets.py table                         # of what is scored

``taught`` needs ``sight`` of its seed, and ``tuned`` needs ``taught``. The other arms are runs of
``studies/benchmark/runs.py``, and policies that ``studies/blind_by_reward/sweep.py row`` leaves.
"""

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from examples.imitate import Budget, Lesson
from fishrl.envs import Flows, Oracle, make_env, make_task, run_episodes
from fishrl.programs.statistics import find_mean
from fishrl.training import Plan, Training, complete, load_plan, load_policy, open_run
from fishrl.training.algorithms.discrete_sac import DiscreteSAC
from fishrl.training.checkpoint import save_checkpoint
from fishrl.training.evaluation import fixed_starts

SIGHT = ("place", "drift", "heading")
LINE: dict[str, Any] = {
    "num_stacked": 16,
    "critic_observes": (*SIGHT, "own_motion", "lateral_line"),
    "critic_reads_stack": False,
}
#: Settings of the task of each arm that is trained here.
ARMS: dict[str, dict[str, Any]] = {
    "label": {**LINE, "observes": ("own_motion", "lateral_line", "flow_label")},
    "sight": {"num_stacked": 4, "observes": (*SIGHT, "own_motion")},
    "tuned": LINE,
}
#: Run folders of all arms.
RUNS = {
    "line": "runs/benchmark/streets-v1-discrete_sac-{}",
    "label": "runs/many_streets/label-{}",
    "sight": "runs/many_streets/sight-{}",
    "taught": "runs/many_streets/taught-{}",
    "tuned": "runs/many_streets/tuned-{}",
    "one": "runs/blind_by_reward/kept/line-sees-unit-no-history-{}",
    "one-sight": "runs/blind_by_reward/kept/sight-unit-{}",
}
SCORES = Path(__file__).parent / "data"
FRAMES, LESSON, TIME = 60_000, 20_000, 321  # decisions; those of a lesson, of 40 T
#: Speeds in L / T and diameters in L beyond those of training.
OUTSIDE = ((0.35, 0.4), (0.6, 0.4), (0.5, 0.25), (0.5, 0.6))


def train(arm: str, seed: int) -> None:
    """Train an arm to its end, or continue it."""
    torch.set_num_threads(1)
    folder = Path(RUNS[arm].format(seed))
    begin: dict[str, Any] = {}
    if arm == "tuned":
        begin = {"initial_policy": RUNS["taught"].format(seed), "critic_frames": 10_000}
        begin["algorithm"] = DiscreteSAC(alpha_init=0.01)
    frames = FRAMES - (LESSON if begin else 0)
    plan = Plan(
        **begin,
        task=make_task("streets-v1", **ARMS[arm]),
        recognition=Oracle() if arm == "label" else None,
        seed=seed,
        flows=Flows(num_envs=16),
        scale_inputs=True,
        actor_average=FRAMES // 3,
        warmup_frames=1280,
        updates_per_frame=1.0,
        batch_size=256,
        buffer_size=60_000,
        total_frames=frames,
        folder=str(folder.parent),
        name=folder.name,
        log_frames=512,
        checkpoint_frames=4000,
        keep_checkpoints=1,
        eval_frames=frames,  # nothing is selected
        eval_episodes=1,
        final_episodes=1,
        baselines=(),
    )
    opened = open_run(plan)
    if opened.summary is None:
        complete(Training(opened))


def teach(seed: int) -> None:
    """Teach a fish with a lateral line what one that sees does, in the same streets."""
    torch.set_num_threads(1)
    folder = Path(RUNS["taught"].format(seed))
    if folder.is_dir():
        return
    teacher, budget = RUNS["sight"].format(seed), Budget(decisions=LESSON, seed=seed)
    lesson = Lesson(teacher, ("own_motion", "lateral_line"), budget)
    rounds, config = lesson.give(flows=Flows(num_envs=16)), lesson.plan.to_config()
    save_checkpoint(folder, {"actor": lesson.policy}, spec=lesson.spec, frames=rounds[-1][0], config=config)


def score(arm: str, seed: int) -> None:
    """Score the last policy of a run in each street."""
    folder = RUNS[arm].format(seed)
    policy, plan = load_policy(folder), load_plan(folder)
    known = make_task("streets-v1").stream
    speeds, sizes = zip(*OUTSIDE, strict=True)
    outside = replace(known, speeds_bl=speeds, diameter_bl=sizes)
    results: dict[str, list[float]] = {}
    for stream, num in ((known, 8), *([] if arm == "label" else [(outside, 12)])):
        for flow, (speed, size) in enumerate(zip(stream.speeds_bl, stream.diameter_bl, strict=True)):
            task = replace(plan.task, stream=stream, start_flows=(flow,), time_limit=TIME)
            env = make_env(task=task, recognition=plan.recognition, flows=Flows(num_envs=8))
            found = run_episodes(env, policy, fixed_starts(task, num, seed=5))
            env.close()
            results[f"{speed} {size}"] = (found.lengths * found.interval_T).tolist()
            print(arm, seed, speed, size, found.metrics()["mean_length_T"], flush=True)
    SCORES.mkdir(exist_ok=True)
    (SCORES / f"{arm}-{seed}.json").write_text(json.dumps(results))


def table() -> None:
    """Print the durations of each arm, seed by seed, in T."""
    task = make_task("streets-v1")
    pairs = [*zip(task.stream.speeds_bl, task.stream.diameter_bl, strict=True)]
    trained = {pairs[flow] for flow in task.start_flows}
    kinds = {
        "own street": [(0.5, 0.4)],
        "trained": [pair for pair in pairs if pair in trained],
        "left out": [pair for pair in pairs if pair not in trained],
        **{f"{speed} L/T, {size} L": [(speed, size)] for speed, size in OUTSIDE},
    }
    print("| arm |", " | ".join(kinds), "|")
    for arm in RUNS:
        scores = [json.loads(path.read_text()) for path in sorted(SCORES.glob(f"{arm}-[0-9].json"))]
        cells = []
        for chosen in kinds.values() if scores else ():
            names = [f"{speed} {size}" for speed, size in chosen]
            found = [[own[name] for name in names] for own in scores if names[0] in own]
            each = [torch.tensor(own).mean().item() for own in found]
            mean = f"{find_mean(each).show('.3g')}: " if len(each) > 1 else ""
            cells.append(mean + ", ".join(f"{value:.1f}" for value in each))
        if cells:
            print(f"| `{arm}` |", " | ".join(cells), "|")


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("what", choices=("train", "score", "table"))
    parser.add_argument("--arm", choices=RUNS, default="line")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    if options.what == "table":
        table()
    elif options.what == "train":
        if options.arm == "taught":
            teach(options.seed)
        elif options.arm in ARMS:
            train(options.arm, options.seed)
        else:
            parser.error(f"{options.arm} is trained elsewhere: see the plan")
    else:
        score(options.arm, options.seed)
