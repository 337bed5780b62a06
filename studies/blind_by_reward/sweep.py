"""Train and score the arms of ``plan.md``.

    python studies/blind_by_reward/sweep.py train --arm line-sees-unit --seed 0    # continues a run
    python studies/blind_by_reward/sweep.py score --arm line-sees-unit --seed 0
    python studies/blind_by_reward/sweep.py store --arm line-sees-unit --seed 0    # weights, curve
    python studies/blind_by_reward/sweep.py table                                  # of what is scored
    python studies/blind_by_reward/sweep.py vary --arm line-sees-unit-no-history --seed 0
    python studies/blind_by_reward/sweep.py row --arm sight-unit --seed 0    # of the benchmark
"""

import argparse
import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from fishrl.benchmark.versions import FOLDER
from fishrl.envs import Flows, KarmanGait, make_env, run_episodes
from fishrl.envs import make_task as make_version
from fishrl.programs.score import score as score_frozen
from fishrl.programs.statistics import find_mean
from fishrl.training import Callback, LearningSettings, Plan, RunSettings, Training, complete
from fishrl.training import load_plan, load_policy, open_run
from fishrl.training.checkpoint import save_checkpoint
from fishrl.training.evaluation import fixed_starts
from fishrl.training.export import export_policy
from fishrl.training.policy_spec import PolicySpec
from fishrl.training.run_folder import write_json

SIGHT, LINE, OWN = ("place", "drift", "heading"), "lateral_line", "own_motion"
SEES: dict[str, Any] = {"critic_observes": SIGHT}
#: Settings of the task, and whether inputs have unit scale, in the order of the plan.
ARMS: dict[str, tuple[dict[str, Any], bool]] = {
    "line-sees-unit": ({"observes": (OWN, LINE), **SEES}, True),
    "line-symmetric-unit": ({"observes": (OWN, LINE)}, True),
    "line-sees-raw": ({"observes": (OWN, LINE), **SEES}, False),
    "line-symmetric-raw": ({"observes": (OWN, LINE)}, False),
    "own-sees-unit": ({"observes": (OWN,), **SEES}, True),
    "sight-unit": ({"observes": (*SIGHT, OWN), "num_stacked": 4}, True),
    "line-sees-unit-no-history": (
        {
            "observes": (OWN, LINE),
            "critic_observes": (*SIGHT, OWN, LINE),
            "critic_reads_stack": False,
        },
        True,
    ),
}
FRAMES, EVERY = 60_000, 1000
RUNS, SCORES = Path("runs/blind_by_reward"), Path(__file__).parent / "data"
#: Horizons in decisions of the averages that act; 0 is the last actor.
RULES = {"last": 0, "average-5000": 5_000, "average-20000": 20_000}
#: Starts by their seed and number, and decisions: 161 are 20 T.
SETS = {"validation": (1, 16, 321), "test": (0, 48, 321), "test-100-T": (0, 48, 801)}

#: Arms that differ in one thing.
COMPARED = (
    ("line-sees-unit", "line-symmetric-unit"),
    ("line-sees-raw", "line-symmetric-raw"),
    ("line-sees-unit", "line-sees-raw"),
    ("line-symmetric-unit", "line-symmetric-raw"),
    ("line-sees-unit", "own-sees-unit"),
    ("line-sees-unit-no-history", "own-sees-unit"),
    ("line-sees-unit-no-history", "line-sees-unit"),
)
#: Arms whose policies are in the zoo.
ZOO = {
    "line-sees-unit-no-history": ("gait_bend_blind_line", "blind, with lateral line"),
    "own-sees-unit": ("gait_bend_blind", "blind, without lateral line"),
    "sight-unit": ("gait_bend_wide", "place and heading seen, in a wider area"),
}
#: Arms whose task is a frozen one.
VERSIONS = {
    "line-sees-unit-no-history": "station-line-v1",
    "own-sees-unit": "station-blind-v1",
    "sight-unit": "station-v1",
}
#: Conditions of the plan in which the best blind arm is tried, by settings of the stream or sense.
STREAMS: dict[str, Any] = {f"stream {u} L/T": {"speeds_bl": (u,)} for u in (0.4, 0.45, 0.55, 0.6)}
STREAMS |= {f"disc {d} L": {"diameter_bl": d} for d in (0.3, 0.5)}
SIGNALS = {"noise 0.1": {"noise": 0.1}, "delay of 2": {"delay": 2}}
SIGNALS |= {f"silence {s}": {"silence": s} for s in (0.2, 1.0)}


def make_task(**changes: Any) -> KarmanGait:
    """Return the task of ``gait_bend`` in the wider area."""
    task: Any = load_plan("zoo/gait_bend").task
    area = replace(task.safe_area, aside_bl=1.15)
    return replace(task, **{"num_stacked": 16, "safe_area": area, **changes})


def make_plan(arm: str, seed: int) -> Plan:
    """Return the plan of a run."""
    task, scale_inputs = ARMS[arm]
    learning = LearningSettings(
        seed=seed,
        flows=Flows(num_envs=16),
        warmup_frames=1280,
        updates_per_frame=1.0,
        batch_size=256,
        buffer_size=60_000,
        scale_inputs=scale_inputs,
    )
    run = RunSettings(
        total_frames=FRAMES,
        folder=str(RUNS),
        name=f"{arm}-{seed}",
        log_frames=512,
        checkpoint_frames=4000,
        keep_checkpoints=1,
        eval_frames=FRAMES,
        eval_episodes=1,
        final_episodes=1,
        baselines=(),
    )
    return Plan(task=make_task(**task), **vars(learning), **vars(run))


class Snapshots(Callback):
    """Keep the policy every ``EVERY`` decisions."""

    def __init__(self) -> None:
        self.training: Training | None = None

    def on_progress(self, amount: int, *_: Any) -> None:
        """Save it if it is due."""
        if self.training is None:
            return
        frames, folder = self.training.counters.frames, self.training.folder.path / "actors"
        if frames // EVERY > (frames - amount) // EVERY:
            folder.mkdir(exist_ok=True)
            weights = self.training.learner.actor.state_dict()
            torch.save(weights, folder / f"{frames // EVERY * EVERY:06d}.pt")


def train(arm: str, seed: int) -> None:
    """Train an arm to its end, or continue it."""
    torch.set_num_threads(1)
    opened, snapshots = open_run(make_plan(arm, seed)), Snapshots()
    if opened.summary is None:
        snapshots.training = Training(opened, callbacks=[snapshots])
        complete(snapshots.training)


def average(folder: Path, horizon: int) -> dict[str, torch.Tensor]:
    """Return the exponential average of the snapshots' weights, as ``actor_average`` forms it."""
    mean: dict[str, torch.Tensor] = {}
    for number, path in enumerate(sorted(folder.glob("*.pt")), 1):
        rate = max(1.0 / number, EVERY / max(horizon, EVERY))
        newest = torch.load(path, weights_only=True)
        mean = {name: value.lerp(newest[name], rate) for name, value in mean.items()} or newest
    return mean


def score(arm: str, seed: int) -> None:
    """Score a run by each rule on each set of starts."""
    run, results, stored = RUNS / f"{arm}-{seed}", {}, SCORES / f"{arm}-{seed}.pt"
    policy = load_policy(run)
    weights = torch.load(stored, weights_only=True) if stored.is_file() else {}
    for rule, horizon in RULES.items():
        policy.load_state_dict(weights.get(rule) or average(run / "actors", horizon))
        for name, (start_seed, num, decisions) in SETS.items():
            task = replace(make_task(**ARMS[arm][0]), time_limit=decisions)
            env = make_env(task=task, flows=Flows(num_envs=16))
            result = run_episodes(env, policy, fixed_starts(task, num, seed=start_seed))
            env.close()
            lengths = (result.lengths * result.interval_T).tolist()
            results[f"{rule}/{name}"] = {
                "T": result.metrics()["mean_length_T"],
                "lasts": result.metrics()["success_rate"],
                "lengths_T": [round(length, 2) for length in lengths],
                "succeeded": result.succeeded.int().tolist(),
                "terms": {term: float(sums.mean()) for term, sums in result.terms.items()},
            }
    SCORES.mkdir(parents=True, exist_ok=True)
    (SCORES / f"{arm}-{seed}.json").write_text(json.dumps(results, indent=1))


def read_scores(arm: str) -> list[dict[str, Any]]:
    """Return the scores of an arm's seeds."""
    return [json.loads(path.read_text()) for path in sorted(SCORES.glob(f"{arm}-[0-9].json"))]


def choose_rule(scores: list[dict[str, Any]]) -> str:
    """Return the rule to be quoted: the longest mean on the validation starts over the seeds."""
    return max(RULES, key=lambda rule: sum(each[f"{rule}/validation"]["T"] for each in scores))


def store(arm: str, seed: int) -> None:
    """Keep the learning curve, and the weights of the rule that is quoted now."""
    run, rule = RUNS / f"{arm}-{seed}", choose_rule(read_scores(arm))
    torch.save({rule: average(run / "actors", RULES[rule])}, SCORES / f"{arm}-{seed}.pt")
    shutil.copy(run / "metrics.csv", SCORES / f"{arm}-{seed}.csv")
    print(arm, seed, rule)


def load_actor(arm: str, seed: int) -> Any:
    """Return the policy whose weights are stored."""
    plan = make_plan(arm, seed)
    actor = plan.algorithm.make_policy(PolicySpec.for_task(plan.task, hidden=plan.hidden))
    (weights,) = torch.load(SCORES / f"{arm}-{seed}.pt", weights_only=True).values()
    actor.load_state_dict(weights)
    return actor


def vary(arm: str, seed: int) -> None:
    """Score the stored policy on the test starts in other streams and with other signals."""
    task, actor, results = make_task(**ARMS[arm][0], time_limit=321), load_actor(arm, seed), {}
    changed = {name: replace(task, stream=replace(task.stream, **s)) for name, s in STREAMS.items()}
    for name, signals in SIGNALS.items():
        changed[name] = replace(task, lateral_line=replace(task.lateral_line, **signals))
    for name, other in {"as trained": task, **changed}.items():
        env = make_env(task=other, flows=Flows(num_envs=16))
        found = run_episodes(env, actor, fixed_starts(other, 48, seed=0)).metrics()
        env.close()
        results[name] = {"T": found["mean_length_T"], "lasts": found["success_rate"]}
        print(f"{name:18s}{found['mean_length_T']:5.1f} T, {found['success_rate']:.0%} last", flush=True)
    (SCORES / f"varied-{arm}-{seed}.json").write_text(json.dumps(results, indent=1))


def make_run(arm: str, seed: int) -> Path:
    """Return a run folder of the policy whose weights are stored."""
    plan, run = make_plan(arm, seed), RUNS / "kept" / f"{arm}-{seed}"
    spec, actor = PolicySpec.for_task(plan.task, hidden=plan.hidden), {"actor": load_actor(arm, seed)}
    save_checkpoint(run, actor, spec=spec, frames=FRAMES, config=plan.to_config())
    shutil.copy(SCORES / f"{arm}-{seed}.csv", run / "metrics.csv")
    return run


def add_row(arm: str, seed: int) -> None:
    """Score the stored policy on the frozen task of its arm, and store the row."""
    name = VERSIONS[arm]
    row = score_frozen(
        str(make_run(arm, seed)), task=make_version(name), name=f"discrete_sac, seed {seed}"
    )
    write_json(FOLDER / "scores" / name / f"discrete_sac-{seed}.json", row.model_dump())
    print(row.policy, row.value, row.low, row.high, row.differs)


def keep(arm: str, seed: int) -> None:
    """Write the policy whose weights are stored as one of the zoo, with its scores on the test."""
    (rule,) = torch.load(SCORES / f"{arm}-{seed}.pt", weights_only=True)
    scores = json.loads((SCORES / f"{arm}-{seed}.json").read_text())[f"{rule}/test"]
    run = make_run(arm, seed)
    result = {
        "success_rate": scores["lasts"],
        "mean_return": sum(scores["terms"].values()),
        "mean_length_T": scores["T"],
        "episodes": len(scores["succeeded"]),
    }
    write_json(run / "summary.json", result)
    name, words = ZOO[arm]
    title = f"Kármán gait by bending, {words}, by reward alone"
    folder = export_policy(run, RUNS / "zoo" / name, title=title)
    card = folder / "README.md"
    words = card.read_text().replace("Final evaluation from", "Evaluation for 40 T (`task.time_limit=321`) from")
    card.write_text(words)
    print(folder)


def table() -> None:
    """Print the page's tables, of the seeds that are scored."""
    scores = {arm: read_scores(arm) for arm in ARMS}
    rules = {arm: choose_rule(found) for arm, found in scores.items() if found}
    found = {arm: [each[f"{rule}/test"] for each in scores[arm]] for arm, rule in rules.items()}
    later = {arm: [each[f"{rule}/test-100-T"] for each in scores[arm]] for arm, rule in rules.items()}
    tests = [each[f"{rule}/test"]["succeeded"] for all_ in scores.values() for each in all_ for rule in RULES]
    possible = torch.tensor(tests).any(0)
    print("| arm | of 40 T | mean | lasts | of 100 T | lasts | rule |")
    for arm in sorted(found, key=lambda arm: -sum(each["T"] for each in found[arm]) / len(found[arm])):
        cells = []
        for each in (found[arm], later[arm]):
            lengths = [one["T"] for one in each]
            mean = f" | {find_mean(lengths).show('.1f')}" if each is found[arm] else ""
            cells.append(", ".join(f"{length:.1f}" for length in lengths) + " T" + mean)
            cells.append(", ".join(f"{100 * one['lasts']:.0f}" for one in each) + " %")
        print(f"| `{arm}` | {' | '.join(cells)} | {rules[arm]} |")
    print("\nother rules, test, of 40 T:")
    for arm, all_ in scores.items():
        means = {rule: [round(each[f"{rule}/test"]["T"], 1) for each in all_] for rule in RULES}
        print(arm, means)
    print("\npaired differences, of 40 T:")
    for one, other in COMPARED:
        pairs = zip(found[one], found[other], strict=False)
        differences = [a["T"] - b["T"] for a, b in pairs]
        each = ", ".join(f"{difference:.1f}" for difference in differences)
        print(f"{one} - {other}: {each}; {find_mean(differences).show('.1f')}")
    held = [int((torch.tensor(each["succeeded"]).bool() & possible).sum()) for each in found["sight-unit"]]
    print(f"\nstarts that a network survived: {int(possible.sum())}; sight {held}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("what", choices=("train", "score", "store", "vary", "keep", "row", "table"))
    parser.add_argument("--arm", choices=ARMS, default="line-sees-unit")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    if options.what == "table":
        table()
    else:
        do = {"train": train, "score": score, "store": store, "vary": vary, "keep": keep}
        (do | {"row": add_row})[options.what](options.arm, options.seed)
