"""Compare followers with fish alone: ``python -m experiments.following runs=[runs/a,runs/b]``.

Runs each learned policy of ``task=follower``, and the baseline, from the same starts behind the
leader and alone in the same stream, and counts the work of the muscles per distance swum through
the water. Writes ``following.json``, ``following.md`` and ``following.png``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import TransformedEnv

from experiments.figures.style import panels, tidy
from experiments.pages import write_table
from experiments.program import TaskSettings, check_names, program
from experiments.statistics import Statistic
from fishrl.bounds import bounded
from fishrl.envs import Follower, make_env
from fishrl.envs.episodes import count_decisions, run_episodes
from fishrl.envs.views import compute_fields
from fishrl.training import load_policy
from fishrl.training.baselines import make_baseline
from fishrl.training.description import make
from fishrl.training.evaluation import fixed_starts
from fishrl.training.policies import load_plan
from fishrl.training.progress import Progress
from fishrl.training.run_folder import write_json

#: Decisions between pictures of the flow, of which the last one is kept.
SNAPSHOT = 40
#: Settings of the task that may be other than in training.
VARIED = ("leader", "time_limit", "start_x_bl", "start_y_bl", "start_degrees")


@dataclass(frozen=True, kw_only=True)
class FollowingSettings(TaskSettings):
    """Settings of the comparison.

    Args:
        runs: run folders of learned policies, one per seed.
        baseline: hand-crafted policy.
        episodes: episodes of each policy, behind the leader and alone.
        periods: duration of an episode in T.
        settle_T: time at the beginning that is not counted, while the fish accelerates; the work
            of episodes shorter than twice that is left out.
        folder: folder for the results.
        compile: compile the flow.
    """

    runs: tuple[str, ...] = ()
    baseline: str = "keep_place"
    episodes: int = bounded(16, least=1)
    periods: float = bounded(100.0, greater=0)
    settle_T: float = bounded(10.0, least=0)
    folder: str = "runs/following"
    compile: bool = True


class Record(NamedTuple):
    """E episodes of N decisions; NaN after the end of an episode."""

    place: Tensor  #: [E, N, 2] centre of mass behind the leader, L
    work: Tensor  #: [E, N] of the muscles since the start, rho L^4 / T^2
    way: Tensor  #: [E, N] through the water, L
    frequency: Tensor  #: [E, N] beats per T
    lengths: Tensor  #: [E] decisions
    survived: Tensor  #: [E] bool
    contact: Tensor  #: [E] bool
    diverged: Tensor  #: [E] bool
    outlines: list[Tensor]  #: of the bodies in the first flow, [K, 2] each, nodes
    vorticity: Tensor  #: [Y, X] there, per T


def record(env: TransformedEnv, policy: Any, *, advance: Callable[[], object]) -> Record:
    """Run one episode in each flow, from the same starts for every policy."""
    task, episodes = env.base_env.task, env.batch_size[0]
    starts = fixed_starts(task, episodes, seed=0)
    rows: list[Tensor] = []
    pictures: list[tuple[list[Tensor], Tensor]] = []
    contact = torch.zeros(episodes, dtype=torch.bool)

    def keep(start_of: Tensor, step: TensorDictBase) -> None:
        after = step["next"]
        frequency = env.base_env.solver.body.frequency * task.scales.period
        entries = (after["place"], after["work"], after["way"], frequency[:, None])
        rows.append(torch.cat([entry.double() for entry in entries], -1))
        contact.logical_or_((start_of >= 0) & after["contact"][:, 0])
        if len(rows) % SNAPSHOT == 1 and start_of[0] == 0:  # flows are reset when episodes end
            solver = env.base_env.solver
            outlines = [solver.markers(m)[0] for m in range(len(solver.bodies))]
            pictures[:] = [(outlines, compute_fields(solver, task.scales)["vorticity"][0].float())]
        advance()

    outcome = run_episodes(env, policy, starts, on_step=keep)
    series, (outlines, vorticity) = torch.stack(rows, 1), pictures[-1]
    series[torch.arange(series.shape[1]) >= outcome.lengths[:, None]] = torch.nan
    work, way, frequency = series[..., 2:].unbind(-1)
    done = (outcome.lengths, outcome.succeeded, contact, outcome.diverged, outlines, vorticity)
    return Record(series[..., :2], work, way, frequency, *done)


def summarise(done: Record, task: Follower, *, settle_T: float) -> dict[str, list[float]]:
    """Return, per episode, what counts after ``settle_T``.

    The cost of an episode shorter than twice that is NaN: it would hang on a few beats.
    """
    first = round(settle_T / task.interval_T)
    last = (done.lengths - 1).clamp_min(0)[:, None]
    early = last.new_full(last.shape, min(first, done.work.shape[1] - 1))
    work, way = (s.gather(1, last) - s.gather(1, early) for s in (done.work, done.way))
    is_long = last + 1 >= 2 * max(1, first)
    cost = torch.where(is_long, work / way, torch.nan)
    return {
        "cost": cost[:, 0].tolist(),
        "x": done.place[:, first:, 0].nanmean(1).tolist(),
        "aside": done.place[:, first:, 1].abs().nanmean(1).tolist(),
        "frequency": done.frequency[:, first:].nanmean(1).tolist(),
        "survival_T": (done.lengths * task.interval_T).tolist(),
        "survived": done.survived.double().tolist(),
        "contact": done.contact.double().tolist(),
        "diverged": done.diverged.double().tolist(),
    }


def tabulate(
    results: dict[str, dict[str, list[float]]], *, cost_alone: float, baseline: str
) -> str:
    """Return the table of all arms, Markdown; ``cost_alone`` is the cost of the baseline alone."""
    heads = (
        *("policy", "survived", "contact", "diverged", "survival, T"),
        *("x, L", "aside, L", "beats per T"),
        *("work per L", f"relative to {baseline} alone"),
    )
    rows = []
    for name, arm in results.items():
        fine = {key: Statistic.of(each) for key, each in arm.items()}
        relative = Statistic.of((torch.tensor(arm["cost"]) / cost_alone).tolist())
        row = [name, *(fine[key].show(".0%") for key in ("survived", "contact", "diverged"))]
        row += [fine[key].show(".2f") for key in ("survival_T", "x", "aside", "frequency")]
        rows.append([*row, fine["cost"].show(".4f"), relative.show(".2f")])
    return write_table(heads, rows)


def average(policies: Sequence[dict[str, list[float]]]) -> dict[str, list[float]]:
    """Return the mean over the episodes of each policy, as values of one arm."""
    return {key: [Statistic.of(arm[key]).mean for arm in policies] for key in policies[0]}


def write_figure(path: Path, tried: dict[str, Record], results: dict[str, Any]) -> None:
    """Draw the flow at the end of the first arm, the paths of all, and cost against distance."""
    with panels(path, size=(10.0, 3.4), columns=3, has_grid=False) as axes:
        flow, paths, costs = axes.flat
        shown = next(iter(tried.values()))
        flow.imshow(shown.vorticity, origin="lower", cmap="RdBu_r", vmin=-15, vmax=15)
        for body in shown.outlines:
            flow.fill(*body.T, color="black")
        flow.set(title=next(iter(tried)), xlabel="x [nodes]", ylabel="y [nodes]")
        for name, done in tried.items():
            (line,) = paths.plot(*done.place[0].T, linewidth=0.8, label=name)
            arm = results[name]
            costs.scatter(arm["x"], arm["cost"], s=10, color=line.get_color(), label=name)
        paths.set(xlabel="x behind the leader [L]", ylabel="y [L]", title="first start")
        costs.set(xlabel="mean x behind the leader [L]", ylabel="work per L [ρL⁴/T²]")
        costs.set_ylim(bottom=0.0)
        costs.legend(fontsize=6)
        for each in (paths, costs):
            tidy(each)


def check_tasks(runs: Sequence[str], task: Follower) -> None:
    """Raise ValueError if a policy was trained in another task; ``VARIED`` may differ."""
    varied = {name: getattr(task, name) for name in VARIED}
    for run in runs:
        own = load_plan(run)[1].task
        if not isinstance(own, Follower) or replace(own, **varied) != task:
            raise ValueError(f"{run}: was trained in another task; give its preset and settings")


@program(FollowingSettings, groups={"task": "follower", "preset": None})
def main(settings: FollowingSettings) -> None:
    """Try all policies, and write table and figure."""
    torch.set_num_threads(1)
    check_names([*(Path(run).name for run in settings.runs), settings.baseline])
    task = make(settings.task, kind=Follower)
    task = replace(task, time_limit=count_decisions(task, settings.periods))
    check_tasks(settings.runs, task)
    places = {"behind the leader": task, "alone": replace(task, leader="none")}
    folder, tried = Path(settings.folder), dict[str, Record]()
    with Progress() as progress:
        for place, where in places.items():
            env = make_env(task=where, num_envs=settings.episodes, compile=settings.compile)
            for run in (*settings.runs, settings.baseline):
                name = f"{Path(run).name}, {place}"
                if run == settings.baseline:
                    policy = make_baseline(run, task=where, seed=0)
                else:
                    policy = load_policy(run, task=where)
                progress.start(name, total=where.time_limit)
                tried[name] = record(env, policy, advance=lambda: progress.advance(1))
            env.close()
    results = {
        name: summarise(done, task, settle_T=settings.settle_T) for name, done in tried.items()
    }
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / "following.json", results)
    shown, num = dict(results), len(settings.runs)
    for place in places if num > 1 else ():
        policies = [results[f"{Path(run).name}, {place}"] for run in settings.runs]
        shown[f"mean of {num} policies, {place}"] = average(policies)
    alone = Statistic.of(results[f"{settings.baseline}, alone"]["cost"])
    table = tabulate(shown, cost_alone=alone.mean, baseline=settings.baseline)
    (folder / "following.md").write_text(table, encoding="utf-8")
    write_figure(folder / "following.png", tried, results)
    print(table)
    print(f"written to {folder}")


if __name__ == "__main__":
    main()
