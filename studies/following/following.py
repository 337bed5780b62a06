"""Compare followers with fish alone: ``PYTHONPATH=. python studies/following/following.py runs/a``.

Runs each learned policy of ``task=follower``, and ``keep_place``, from the same starts behind the
leader and alone in the same stream, and counts the work of the muscles per distance swum through
the water. Writes ``data/followers.csv`` and ``following.png``.
"""

import argparse
import csv
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor

from fishrl.envs import Follower, make_env
from fishrl.envs.episodes import count_decisions, run_episodes
from fishrl.envs.views import compute_fields
from fishrl.programs.figures.style import panels, tidy
from fishrl.programs.statistics import find_mean
from fishrl.programs.train_settings import TRAINING
from fishrl.training.baselines import make_baseline
from fishrl.training.evaluation import fixed_starts
from fishrl.training.policies import load_plan, load_policy

FOLDER = Path(__file__).parent
EPISODES, PERIODS = 16, 40
#: Time that is not counted, while the fish accelerates; shorter than twice that is left out.
SETTLE_T = 10.0
#: Time at which the flow is drawn.
PICTURE_T = 20.0
#: Columns: heading, entry of ``run_all``, format.
COLUMNS = (
    ("survived 40 T, %", "survived", ".0f"),
    ("contact, %", "contact", ".0f"),
    ("survival, T", "survival_T", ".1f"),
    ("mean x, L", "x", ".2f"),
    ("mean |y|, L", "aside", ".2f"),
    ("beats per T", "frequency", ".2f"),
    ("work per L, ρL⁴/T²", "cost", ".3f"),
)


def run_all(task: Follower, policy: Any) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Return the numbers of each episode, ``[E]``, and what the figure needs."""
    env = make_env(task=task, num_envs=EPISODES)
    base = env.base_env
    shown: dict[str, Any] = {}

    def read(start_of: Tensor, step: TensorDictBase) -> dict[str, Tensor]:
        is_due = base.now["age"][0] >= PICTURE_T * task.scales.period
        if start_of[0] == 0 and is_due and not shown:
            bodies = range(len(base.solver.bodies))
            shown["outlines"] = [base.solver.markers(body)[0] for body in bodies]
            shown["field"] = compute_fields(base.solver, task.scales)["vorticity"][0]
        after = {name: step["next", name] for name in ("place", "work", "way", "contact")}
        frequency = base.solver.body.frequency[:, None] * task.scales.period
        return after | {"frequency": frequency}

    episodes = run_episodes(env, policy, fixed_starts(task, EPISODES, seed=0), on_step=read)
    env.close()
    series = {name: episodes.traces.pad(name) for name in ("place", "work", "way", "frequency")}
    contact = torch.stack([flag.any() for flag in episodes.traces["contact"]])
    first = round(SETTLE_T / task.interval_T)
    last = (episodes.lengths - 1)[:, None]
    early = torch.full_like(last, first).minimum(last)
    work, way = (
        series[name].squeeze(-1).gather(1, last) - series[name].squeeze(-1).gather(1, early)
        for name in ("work", "way")
    )
    numbers = {
        "survived": 100.0 * episodes.succeeded.double(),
        "contact": 100.0 * contact.double(),
        "survival_T": episodes.lengths * task.interval_T,
        "x": series["place"][:, first:, 0].nanmean(1),
        "aside": series["place"][:, first:, 1].abs().nanmean(1),
        "frequency": series["frequency"][:, first:, 0].nanmean(1),
        "cost": torch.where(last + 1 >= 2 * first, work / way, torch.nan)[:, 0],
    }
    return numbers, shown | {"path": series["place"][0]}


def tabulate(results: dict[str, dict[str, Tensor]], seeds: list[str]) -> None:
    """Write the table: means with 95 % intervals over episodes, and of policies over seeds."""
    rows = []
    alone = float(results["`keep_place`, alone"]["cost"].nanmean())
    for where in ("behind the leader", "alone") if len(seeds) > 1 else ():
        means = [
            {name: value.nanmean() for name, value in results[f"{seed}, {where}"].items()}
            for seed in seeds
        ]
        together = {name: torch.stack([mean[name] for mean in means]) for name in means[0]}
        results[f"mean of {len(seeds)} policies, {where}"] = together
    for name, numbers in results.items():
        row = {"policy": name}
        relative = ("relative to `keep_place` alone", "relative", ".2f")
        numbers["relative"] = numbers["cost"] / alone
        for head, key, form in (*COLUMNS, relative):
            values = numbers[key][~numbers[key].isnan()].tolist()
            mean = find_mean(values)
            row[head] = format(mean.value, form)
            row[f"{head} ±"] = format(mean.high - mean.value, form)
        rows.append(row)
    with (FOLDER / "data" / "followers.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def draw(path: Path, shown: dict[str, dict[str, Any]], results: dict[str, Any]) -> None:
    """Draw the flow of the first arm, the paths of all, and cost against distance."""
    with panels(path, size=(10.0, 3.4), columns=3, has_grid=False) as axes:
        flow, paths, costs = axes.flat
        name, first = next(iter(shown.items()))
        flow.imshow(first["field"], origin="lower", cmap="RdBu_r", vmin=-15, vmax=15)
        for outline in first["outlines"]:
            flow.fill(*outline.T, color="black")
        flow.set(title=name, xlabel="x [nodes]", ylabel="y [nodes]")
        for name, each in shown.items():
            (line,) = paths.plot(*each["path"].T, linewidth=0.8, label=name)
            own = results[name]
            costs.scatter(own["x"], own["cost"], s=10, color=line.get_color(), label=name)
        paths.set(xlabel="x behind the leader [L]", ylabel="y [L]", title="first start")
        costs.set(xlabel="mean x behind the leader [L]", ylabel="work per L [ρL⁴/T²]")
        costs.set_ylim(bottom=0.0)
        costs.legend(fontsize=6)
        tidy(paths)
        tidy(costs)


def main() -> None:
    """Try all policies, and write table and figure."""
    torch.set_num_threads(1)
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("runs", nargs="*")
    parser.add_argument("--settings", nargs="*", default=["preset=follower_small"])
    given = parser.parse_args()
    task = load_plan(given.runs[0])[1].task if given.runs else TRAINING.read(["algorithm=sac", *given.settings]).task
    assert isinstance(task, Follower)
    task = replace(task, time_limit=count_decisions(task, PERIODS))
    results, shown = {}, {}
    for where, own in {"behind the leader": task, "alone": replace(task, leader="none")}.items():
        policies: dict[str, Any] = {
            f"seed {load_plan(run)[1].seed}": load_policy(run, task=own) for run in given.runs
        }
        policies["`keep_place`"] = make_baseline("keep_place", task=own, seed=0)
        for name, policy in policies.items():
            label = f"{name}, {where}"
            results[label], shown[label] = run_all(own, policy)
            means = {key: float(value.double().nanmean()) for key, value in results[label].items()}
            print(label, {key: round(mean, 3) for key, mean in means.items()}, flush=True)
    tabulate(results, [f"seed {load_plan(run)[1].seed}" for run in given.runs])
    draw(FOLDER / "following.png", shown, results)


if __name__ == "__main__":
    main()
