"""What fish that learned by reward alone do behind the half disc, and what they feel.

    python studies/blind_by_reward/behaviour.py run     # each policy, then without some signals
    python studies/blind_by_reward/behaviour.py draw    # behaviour.png and behaviour.csv

Starts are those of seed 2, neither of selection nor of the test. A signal is taken away by 0, as
``LateralLine.silence`` does. Episodes are kept in ``runs/blind_by_reward/behaviour``.
"""

import argparse
import csv
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import torch
from matplotlib.patches import Wedge
from sweep import ARMS, load_actor, make_task
from tensordict import TensorDictBase

from experiments.gait.diagnostics import find_phase
from experiments.gait.trials import list_shedding
from fishrl.envs import Flows, make_env, run_episodes
from fishrl.training.evaluation import fixed_starts

KEPT, FOLDER = Path("runs/blind_by_reward/behaviour"), Path(__file__).parent
STARTS, PERIODS, FRAMES = 24, 40, 8
#: Arm and seed, with the name of its policy in table and picture.
SHOWN = {
    ("sight-unit", 0): "sight",
    ("line-sees-unit-no-history", 0): "lateral line, seed 0",
    ("line-sees-unit-no-history", 1): "lateral line, seed 1",
    ("own-sees-unit", 0): "own motion alone",
}
#: What is taken from policies with a lateral line: neuromasts, features, and whether of the latest
#: signals or of their changes; the neuromasts are the nose, then pairs at 0.2 and 0.7 L.
NOSE, FRONT, REAR = (0,), (1, 2), (3, 4)
LOST: dict[str, tuple[tuple[int, ...], tuple[str, ...], tuple[int, ...]]] = {
    "nose": (NOSE, ("ahead", "left", "pressure"), (0, 1)),
    "front pair": (FRONT, ("ahead", "left", "pressure"), (0, 1)),
    "rear pair": (REAR, ("ahead", "left", "pressure"), (0, 1)),
    "velocities": (NOSE + FRONT + REAR, ("ahead", "left"), (0, 1)),
    "pressures": (NOSE + FRONT + REAR, ("pressure",), (0, 1)),
    "changes": (NOSE + FRONT + REAR, ("ahead", "left", "pressure"), (1,)),
    "all": (NOSE + FRONT + REAR, ("ahead", "left", "pressure"), (0, 1)),
}


def deafen(act: Any, arm: str, lost: str) -> Callable[[TensorDictBase], TensorDictBase]:
    """Return a policy that reads 0 for some signals of the lateral line."""
    task = make_task(**ARMS[arm][0])
    line, (masts, names, parts) = task.lateral_line, LOST[lost]
    keep = torch.ones(task.n_obs)
    signals = keep[-len(task.known_senses["lateral_line"].numbers) :].view(
        2, line.num_neuromasts, len(line.features)
    )
    for part in parts:
        for mast in masts:
            for name in names:
                signals[part, mast, line.features.index(name)] = 0.0

    def act_deaf(state: TensorDictBase) -> TensorDictBase:
        state["observation_stack"] = state["observation_stack"] * keep.repeat(task.num_stacked)
        return act(state)

    return act_deaf


def run(arm: str, seed: int, lost: str | None) -> None:
    """Record the episodes of a policy, unless they are there."""
    path = KEPT / f"{arm}-{seed}-{lost}.pt"
    if path.is_file():
        return
    task = replace(make_task(**ARMS[arm][0]), time_limit=8 * PERIODS + 1)
    env = make_env(task=task, flows=Flows(num_envs=STARTS), frames_per_action=FRAMES)
    base, actor = env.base_env, load_actor(arm, seed)

    def read_frame(start_of: torch.Tensor, flows: Any) -> dict[str, torch.Tensor]:
        fish, disc = flows.solver.bodies
        return {"phase": fish.phase, "impulse": disc.impulse[:, 1]}

    def read_decision(start_of: torch.Tensor, step: TensorDictBase) -> dict[str, torch.Tensor]:
        names = ("place", "facing", "own_motion", "positive_work")
        return {name: base.now[name] for name in names}

    result = run_episodes(
        env,
        actor if lost is None else deafen(actor, arm, lost),
        fixed_starts(task, STARTS, seed=2),
        on_step=read_decision,
        on_frame=read_frame,
    )
    env.close()
    num = task.time_limit
    series = {
        name: result.traces.pad(name, length=num * (FRAMES if name in ("phase", "impulse") else 1))
        for name in result.traces
    }
    KEPT.mkdir(parents=True, exist_ok=True)
    lengths = result.lengths * result.interval_T
    torch.save({**series, "lengths_T": lengths, "succeeded": result.succeeded}, path)


def sway(place: torch.Tensor, shedding: float, per_T: float) -> float:
    """Return the share of the variance of y within a quarter of the shedding frequency."""
    shares = []
    for row in place[..., 1].double():
        y = row[~row.isnan()].numpy()[int(4 * per_T) :]
        if len(y) < 16 * per_T:
            continue
        y = (y - np.polyval(np.polyfit(np.arange(len(y)), y, 1), np.arange(len(y)))) * np.hanning(len(y))
        power, at = np.abs(np.fft.rfft(y)) ** 2, np.fft.rfftfreq(len(y), 1.0 / per_T)
        shares.append(power[np.abs(at / shedding - 1.0) <= 0.25].sum() / power.sum())
    return float(np.mean(shares)) if shares else float("nan")


def lock(angle: torch.Tensor, impulse: torch.Tensor, shedding: float, per_T: float) -> float:
    """Return the length of the mean of exp(i (angle - phase of the lift)) over all episodes."""
    apart = []
    for phases, force in zip(angle[:, 1:], impulse.diff(dim=1), strict=True):
        known = ~(phases.isnan() | force.isnan())
        if int(known.sum()) >= round(16 * per_T):
            own, lift = (row[known].double().numpy() for row in (phases, force))
            apart.append(np.exp(1j * (own - find_phase(lift, shedding, per_T))))
    return float(np.abs(np.concatenate(apart).mean())) if apart else float("nan")


def reduce(kept: dict[str, torch.Tensor], shedding: float, interval_T: float) -> dict[str, str]:
    """Return the columns of the table."""
    place, own, work = kept["place"], kept["own_motion"], kept["positive_work"]
    known = ~place[..., 0].isnan()
    x, y = place[known].unbind(-1)
    smooth = torch.nn.functional.avg_pool1d(place[:, None, :, 1].nan_to_num(), 16, 1)[:, 0]
    sides = torch.where(smooth.abs() > 0.1, smooth.sign(), 0.0)
    crossed = 0
    for row in sides:
        met = row[row != 0.0]
        crossed += int((met[1:] != met[:-1]).sum())
    total_T = float(kept["lengths_T"].sum())
    last = known.sum(1, keepdim=True) - 1
    paid = float(work.gather(1, last).sum() - work[:, 0].sum())
    frames = FRAMES / interval_T
    lift, y_phase = kept["impulse"][:, ::FRAMES], torch.full_like(place[..., 1].double(), torch.nan)
    for row, is_known, into in zip(place[..., 1].double(), known, y_phase, strict=True):
        into[is_known] = torch.from_numpy(find_phase(row[is_known].numpy(), shedding, 1 / interval_T))
    return {
        "duration, T": f"{kept['lengths_T'].double().mean():.1f}",
        "lasts 40 T, %": f"{100 * kept['succeeded'].double().mean():.0f}",
        "x, L": f"{x.mean():.2f}",
        "|y|, L": f"{y.abs().mean():.2f}",
        "beside the street, %": f"{100 * (y.abs() > 0.5).double().mean():.0f}",
        "nearer than 1 L, %": f"{100 * (x < 1.0).double().mean():.0f}",
        "changes of side in 10 T": f"{10 * crossed / total_T:.1f}",
        "beats per T": f"{own[known][:, 3].mean():.2f}",
        "bend, rms, L": f"{own[known][:, 2].square().mean().sqrt():.3f}",
        "heading, rms, degrees": f"{kept['facing'][known].square().mean().sqrt().rad2deg():.0f}",
        "y near shedding, %": f"{100 * sway(place, shedding, 1 / interval_T):.0f}",
        "beat locked to lift": f"{lock(kept['phase'], kept['impulse'], shedding, frames):.2f}",
        "y locked to lift": f"{lock(y_phase, lift, shedding, 1 / interval_T):.2f}",
        "pushing work per T": f"{paid / total_T:.3f}",
    }


def draw() -> None:
    """Write table and picture of what has been recorded."""
    task = make_task(**ARMS["sight-unit"][0])
    shedding, rows = list_shedding(task)[0], []
    figure, panels = plt.subplots(2, 2, figsize=(8, 4.6), sharex=True, sharey=True)
    figure.set_layout_engine("constrained")
    for axes, ((arm, seed), name) in zip(panels.flat, SHOWN.items(), strict=True):
        for lost in (None, *LOST):
            path = KEPT / f"{arm}-{seed}-{lost}.pt"
            if path.is_file():
                kept = torch.load(path, weights_only=True)
                numbers = reduce(kept, shedding, task.interval_T)
                rows.append({"policy": name, "without": lost or "–", **numbers})
        place = torch.load(KEPT / f"{arm}-{seed}-None.pt", weights_only=True)["place"].flatten(0, 1)
        x, y = place[~place[:, 0].isnan()].numpy().T
        bins = (np.arange(0.3, 3.05, 0.1), np.arange(-1.2, 1.25, 0.1))
        axes.hist2d(x, y, bins=bins, weights=np.full(len(x), 100 / len(x)), cmap="Blues", vmax=5)
        axes.add_patch(Wedge((0, 0), 0.2, 90, 270, color="#444444"))
        axes.set(xlim=(-0.4, 3.1), ylim=(-1.2, 1.2), aspect="equal")
        axes.set_title(name, fontsize=9)
    figure.supxlabel("x of the nose behind the flat side, L", fontsize=9)
    figure.supylabel("y, L", fontsize=9)
    bar = figure.colorbar(panels[0, 0].collections[0], ax=panels, shrink=0.8)
    bar.set_label("share of time in a cell of 0.1 L, %")
    figure.savefig(FOLDER / "behaviour.png", dpi=110)
    with (SCORES / "behaviour.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        table.writeheader()
        table.writerows(rows)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("what", choices=("run", "draw"))
    if parser.parse_args().what == "draw":
        draw()
    else:
        torch.set_num_threads(1)
        for arm, seed in SHOWN:
            run(arm, seed, None)
        for arm, seed in SHOWN:
            for lost in LOST if arm.startswith("line") else ():
                run(arm, seed, lost)
