"""Train and score the rows of the benchmark's table, see ``plan.md``.

    python studies/benchmark/runs.py station-v1 discrete_sac 0    # continues a run
    python studies/benchmark/runs.py table                        # into docs/benchmark.md
"""

import argparse
import shutil
from math import sqrt
from pathlib import Path
from typing import Any, NamedTuple

import torch

from fishrl.benchmark import Row, find_version, list_rows, list_versions
from fishrl.benchmark.rows import find_ends
from fishrl.envs import Flows, make_env, make_task
from fishrl.programs.score import score
from fishrl.training import Plan, Training, complete, open_run
from fishrl.training.algorithms.discrete_sac import DiscreteSAC
from fishrl.training.algorithms.dqn import DQN
from fishrl.training.algorithms.drqn import DRQN
from fishrl.training.algorithms.ppo import PPO
from fishrl.training.algorithms.sac import SAC
from fishrl.training.run_folder import write_json

FOLDER = Path("runs/benchmark")
SCORES = Path(__file__).parents[2] / "fishrl/benchmark/scores"
PAGE = Path(__file__).parents[2] / "docs/benchmark.md"
#: Of Student's t, by number of seeds.
QUANTILE = {2: 12.71, 3: 4.30, 4: 3.18, 5: 2.78}
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


class Method(NamedTuple):
    """Rows of one method in a task, one per seed."""

    name: str
    rows: list[Row]

    @property
    def values(self) -> torch.Tensor:
        """Values ``[n]`` of the measure."""
        return torch.tensor([row.value for row in self.rows])


def list_methods(task: str) -> list[Method]:
    """Return the methods of a task, the best mean first."""
    by_name: dict[str, list[Row]] = {}
    for row in list_rows(task, "test"):
        by_name.setdefault(row.policy.partition(", seed ")[0], []).append(row)
    return sorted((Method(*own) for own in by_name.items()), key=lambda m: -m.values.mean())


def describe(method: Method, ends: tuple[float, float] | None) -> str:
    """Return a cell of the page's table."""
    values, num = method.values.sort().values, len(method.rows)
    mean, (low, high) = float(values.mean()), (method.rows[0].low, method.rows[0].high)
    if num > 1:
        width = QUANTILE[num] * float(values.std()) / sqrt(num)
        low, high = mean - width, mean + width
    shown = f"{mean:.3g} [{low:.3g}, {high:.3g}]"
    if not method.rows[0].trained_decisions:
        return shown
    middle = float(values[num // 4 : num - num // 4].mean())
    score = "" if ends is None else f", score {(mean - ends[0]) / (ends[1] - ends[0]):.2f}"
    return f"`{method.name}` ({num}) {shown}, middle {middle:.3g}{score}"


def table() -> None:
    """Write the table of all methods into the page."""
    lines = ["| task | random | controller | trained |", "|---|---|---|---|"]
    for task in (each for each in list_versions() if "quick" not in each):
        ends, methods = find_ends(list_rows(task, "test")), list_methods(task)
        wanted = ("random", find_version(task).controller)
        cells = [describe(m, ends) for name in wanted for m in methods if m.name == name]
        trained = [describe(m, ends) for m in methods if m.rows[0].trained_decisions]
        if trained or find_version(task).references is None:
            lines.append(f"| {' | '.join([f'`{task}`', *cells, '; '.join(trained) or '–'])} |")
    begin, end = "<!-- results: begin -->\n", "<!-- results: end -->"
    before, _, rest = PAGE.read_text().partition(begin)
    _, _, after = rest.partition(end)
    PAGE.write_text("".join((before, begin, *(f"{line}\n" for line in lines), end, after)))
    print("\n".join(lines))


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("task", choices=(*BUDGETS, "table"))
    parser.add_argument("algorithm", nargs="?", default="discrete_sac")
    parser.add_argument("seed", nargs="?", type=int, default=0)
    given = parser.parse_args()
    if given.task == "table":
        table()
    else:
        run(given.task, given.algorithm, given.seed)
