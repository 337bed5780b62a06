"""Train and score the rows of the benchmark's table, see ``plan.md``.

    python studies/benchmark/runs.py station-v1 ppo 0    # continues a run
    python studies/benchmark/runs.py table               # into docs/benchmark.md
    python studies/benchmark/runs.py keep predation-v1   # the best seed in runs/benchmark
"""

import argparse
import shutil
from pathlib import Path
from typing import Any, NamedTuple

import torch

from fishrl.benchmark import Row, find_version, list_rows, list_versions
from fishrl.benchmark.rows import find_ends
from fishrl.envs import Flows, make_env, make_task
from fishrl.programs.score import score
from fishrl.programs.statistics import Interval, find_interquartile_mean, find_mean
from fishrl.training import Plan, Training, complete, open_run
from fishrl.training.algorithms.discrete_sac import DiscreteSAC
from fishrl.training.algorithms.dqn import DQN
from fishrl.training.algorithms.drqn import DRQN
from fishrl.training.algorithms.ppo import PPO
from fishrl.training.algorithms.sac import SAC
from fishrl.training.checkpoint import write_sums
from fishrl.training.export import export_policy, write_results
from fishrl.training.run_folder import write_json

FOLDER = Path("runs/benchmark")
SCORES = Path(__file__).parents[2] / "fishrl/benchmark/scores"
PAGE = Path(__file__).parents[2] / "docs/benchmark.md"
CURVES = Path(__file__).parent / "curves"
SAC_LIKE: dict[str, Any] = {
    "warmup_frames": 1280,
    "updates_per_frame": 1.0,
    "batch_size": 256,
    "buffer_size": 60_000,
}
ALGORITHMS = {
    "discrete_sac": (DiscreteSAC(), SAC_LIKE),
    "dqn": (DQN(), SAC_LIKE),
    "drqn": (DRQN(), SAC_LIKE),
    "ppo": (PPO(), {}),
    "sac": (SAC(), SAC_LIKE),
}
#: Folder of the policy that is kept of a task, in ``studies``, and title of its card.
KEPT = {
    "predation-v1": ("drawn_paths/policies/turn", "Predation, food on drawn paths, by commanded turns"),
    "predation-bend-v1": ("drawn_paths/policies/bend", "Predation, food on drawn paths, by bending"),
    "streets-v1": (
        "many_streets/policies/line",
        "Kármán gait by bending, blind, with its lateral line, in streets that differ",
    ),
}


class Budget(NamedTuple):
    """What a task gets."""

    frames: int
    algorithms: tuple[str, ...] = ("discrete_sac",)
    num_seeds: int = 5
    task: dict[str, Any] = {}  # what a policy may choose
    learning: dict[str, Any] = {}


FIVE = ("discrete_sac", "ppo", "dqn", "drqn", "maskable_ppo")
LINE: dict[str, Any] = {
    "num_stacked": 16,
    "critic_observes": ("place", "drift", "heading", "own_motion", "lateral_line"),
    "critic_reads_stack": False,
}
BUDGETS = {
    "station-v1": Budget(60_000, FIVE[1:], 3, {"num_stacked": 4}),
    "streets-v1": Budget(60_000, task=LINE),
    "predation-v1": Budget(16_000, FIVE, 3),
    "predation-bend-v1": Budget(32_000),
    "pair-v1": Budget(16_000),
    "gait-v1": Budget(20_000),
    "follower-v1": Budget(20_000, ("sac",)),
}


def make_plan(name: str, algorithm: str, seed: int) -> Plan:
    """Return the plan of a run."""
    budget, (kind, learning) = BUDGETS[name], ALGORITHMS[algorithm]
    return Plan(
        task=make_task(name, **budget.task),
        algorithm=kind,
        seed=seed,
        flows=Flows(num_envs=16),
        scale_inputs=True,
        actor_average=budget.frames // 3,
        **{**learning, **budget.learning},
        total_frames=budget.frames,
        folder=str(FOLDER),
        name=f"{name}-{algorithm}-{seed}",
        log_frames=512,
        checkpoint_frames=4000,
        keep_checkpoints=1,
        eval_frames=budget.frames,  # nothing is selected
        eval_episodes=1,
        final_episodes=1,
        baselines=(),
    )


def train(name: str, algorithm: str, seed: int) -> Path:
    """Train to the end, or continue; return what ``fishrl score`` takes."""
    if algorithm == "maskable_ppo":
        return train_archive(name, seed)
    opened = open_run(make_plan(name, algorithm, seed))
    if opened.summary is None:
        complete(Training(opened))
    CURVES.mkdir(exist_ok=True)
    run = FOLDER / f"{name}-{algorithm}-{seed}"
    shutil.copy(run / "metrics.csv", CURVES / f"{run.name}.csv")
    return run


def train_archive(name: str, seed: int) -> Path:
    """Train MaskablePPO of sb3-contrib with its defaults and 32 decisions per flow and update."""
    from sb3_contrib import MaskablePPO
    from stable_baselines3.common.vec_env import VecMonitor

    from fishrl.wrappers.stable_baselines import FlowVecEnv

    path, budget = FOLDER / f"{name}-maskable_ppo-{seed}.zip", BUDGETS[name]
    if not path.is_file():
        task = make_task(name, **budget.task)
        env = VecMonitor(FlowVecEnv(make_env(task=task, flows=Flows(num_envs=16), seed=seed)))
        model = MaskablePPO("MlpPolicy", env, n_steps=32, seed=seed, device="cpu")
        model.learn(budget.frames)
        FOLDER.mkdir(parents=True, exist_ok=True)
        model.save(path)
        env.close()
    return path


def run(name: str, algorithm: str, seed: int) -> None:
    """Train, score on the test and store the row."""
    torch.set_num_threads(1)
    policy = train(name, algorithm, seed)
    row = score(
        str(policy), task=make_task(name), name=f"{algorithm}, seed {seed}", trust=True
    )
    (SCORES / name).mkdir(exist_ok=True)
    write_json(SCORES / name / f"{algorithm}-{seed}.json", row.model_dump())
    print(row.policy, row.value, row.low, row.high)


def keep(name: str) -> None:
    """Keep the policy of the seed that scores best on the validation, with its score on the test."""
    task, (place, title) = make_task(name), KEPT[name]
    runs = sorted(path for path in FOLDER.glob(f"{name}-discrete_sac-[0-9]"))
    values = {run: score(str(run), task=task, split="validation").value for run in runs}
    best = max(runs, key=lambda run: values[run])
    row = score(str(best), task=task)
    folder = export_policy(best, Path(__file__).parents[1] / place, title=title, revision=row.commit)
    write_json(folder / "summary.json", {**row.metrics, "version": name})
    card = folder / "README.md"
    words = f"On the {row.metrics['episodes']} test starts of `{name}`; best of {len(runs)} seeds on the validation:"
    begin, end = "Final evaluation from", "`metrics.csv` holds"
    before, after = card.read_text().split(begin)[0], card.read_text().split(end)[1]
    card.write_text(f"{before}{words}\n\n{write_results(row.metrics)}\n{end}{after}")
    write_sums(folder)
    print(values, folder)


class Method(NamedTuple):
    """Rows of one method in a task, one per seed."""

    name: str
    rows: list[Row]

    @property
    def values(self) -> list[float]:
        """Of the measure."""
        return [row.value for row in self.rows]


def list_methods(task: str) -> list[Method]:
    """Return the methods of a task, the best mean first."""
    found: dict[tuple[str, int | None], list[Row]] = {}
    for row in list_rows(task, "test"):
        name = row.policy.partition(", seed ")[0]
        found.setdefault((name, row.trained_decisions), []).append(row)
    methods = [Method(name, rows) for (name, _), rows in found.items()]
    return sorted(methods, key=lambda method: -find_mean(method.values).value)


def describe(method: Method, ends: tuple[float, float] | None) -> str:
    """Return a cell of the page's table."""
    first, num = method.rows[0], len(method.rows)
    one = Interval(value=first.value, low=first.low, high=first.high)
    mean = find_mean(method.values) if num > 1 else one
    if first.kind == "baseline":
        return mean.show(".3g")
    middle = f", middle {find_interquartile_mean(method.values).value:.3g}" if num > 3 else ""
    score = "" if ends is None else f", score {(mean.value - ends[0]) / (ends[1] - ends[0]):.2f}"
    helped = sorted({row.describe_help() for row in method.rows} - {""})
    helps = f", trained with {'; '.join(helped)}" if helped else ""
    return f"`{method.name}` ({num}) {mean.show('.3g')}{middle}{score}{helps}"


def table() -> None:
    """Write the table of all methods into the page."""
    lines = ["| task | random | controller | policies |", "|---|---|---|---|"]
    for task in (each for each in list_versions() if "quick" not in each):
        rows, methods = list_rows(task, "test"), list_methods(task)
        ends = find_ends(rows) if rows else None
        known = {method.name: describe(method, ends) for method in methods}
        cells = [known.get(name, "–") for name in ("random", find_version(task).controller)]
        others = [describe(m, ends) for m in methods if m.rows[0].kind != "baseline"]
        if others or find_version(task).references is None:
            lines.append(f"| {' | '.join([f'`{task}`', *cells, '; '.join(others) or '–'])} |")
    begin, end = "<!-- results: begin -->\n", "<!-- results: end -->"
    before, _, rest = PAGE.read_text().partition(begin)
    _, _, after = rest.partition(end)
    PAGE.write_text("".join((before, begin, *(f"{line}\n" for line in lines), end, after)))
    print("\n".join(lines))


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("task", choices=(*BUDGETS, "table", "keep"))
    parser.add_argument("algorithm", nargs="?", default="discrete_sac")
    parser.add_argument("seed", nargs="?", type=int, default=0)
    given = parser.parse_args()
    if given.task == "table":
        table()
    elif given.task == "keep":
        keep(given.algorithm)
    else:
        budget = BUDGETS[given.task]
        if given.algorithm not in budget.algorithms or given.seed not in range(budget.num_seeds):
            parser.error(f"the plan has {', '.join(budget.algorithms)}; seeds to {budget.num_seeds - 1}")
        run(given.task, given.algorithm, given.seed)
