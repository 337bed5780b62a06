"""Simulate for long and look for drift: ``python -m tests.campaigns.soak steps=1000000``.

Two flows of L = 32, random legal actions and resets of random rows. Prints memory and open files of
all processes, shared memory, the drift of mass and the speed; ends with status 1 if memory, files
or shared memory grow, mass drifts beyond round-off, or a flow diverges. Compare the speed of the
first and the last rows on a machine that does nothing else.

The walls are half-way bounce-back, which conserves mass exactly. Those of the tasks are
non-equilibrium extrapolation (Guo, Zheng & Shi 2002), which takes the density of a wall node from
its neighbour and so does not: there the mean density fluctuates by some 1e-5.
"""

from __future__ import annotations

import os
import sys
import time
from dataclasses import replace
from typing import Annotated

import torch
from pydantic import Field, NonNegativeInt, PositiveInt
from tensordict import TensorDictBase

from fishrl.envs import Predation, make_env
from fishrl.physics import Boundaries, FlowConfig, NoSlip
from fishrl.programs.program import program
from fishrl.settings import Settings
from tests.campaigns.live import measure

#: Relative; round-off of single precision, 6e-8, over the mean of 5e4 nodes is less.
MAX_DRIFT = 1e-8
SMALL = {"body_length": 32, "reynolds": 2000.0, "max_wall_speed": 0.1, "wall_margin_bl": 0.15}
LIMITS = {"memory_mb": 20.0, "files": 0.0, "shm_mb": 0.0}


class Tank(Predation):  # type: ignore[misc]
    """Predation between walls that conserve mass."""

    def flow_config(self) -> FlowConfig:
        """Return the flow."""
        walls = Boundaries(left=NoSlip(), right=NoSlip(), bottom=NoSlip(), top=NoSlip())
        return replace(super().flow_config(), boundaries=walls)


class SoakSettings(Settings):
    """Settings of the campaign.

    Args:
        steps: lattice steps of each flow.
        rows: of the table.
        reset_share: share of decisions after which random rows are reset.
        compile: compile the flow solver.
        seed: of starts, actions and resets.
    """

    steps: PositiveInt = 1_000_000
    rows: Annotated[int, Field(ge=2)] = 40
    reset_share: Annotated[float, Field(ge=0, le=1)] = 0.02
    compile: bool = True
    seed: NonNegativeInt = 0


def measure_all(env: TensorDictBase) -> dict[str, float]:
    """Return what must not change."""
    density, _ = env.base_env.solver.macroscopic()
    drift = float((density.double().mean((1, 2)) - 1.0).abs().max())
    return measure(os.getpid()) | {"mass_drift": drift}


@program(SoakSettings)
def main(settings: SoakSettings) -> None:
    """Simulate, print rows, compare the last with the first."""
    task = Tank(**SMALL, time_limit=200)
    env = make_env(task=task, num_envs=2, seed=settings.seed, compile=settings.compile)
    torch.manual_seed(settings.seed)
    state, rows, episodes, diverged = env.reset(), [], 0, 0
    decisions = -(-settings.steps // task.n_substeps)
    interval = max(1, decisions // settings.rows)
    began = time.perf_counter()
    for decision in range(1, decisions + 1):
        after, state = env.step_and_maybe_reset(env.rand_action(state))
        episodes += int(after["next", "done"].sum())
        diverged += int(after["next", "diverged"].sum())
        if torch.rand(()) < settings.reset_share:
            state = env.reset(state.set("_reset", torch.rand(2, 1) < 0.5))
        if decision % interval == 0:
            seconds, began = time.perf_counter() - began, time.perf_counter()
            speed = interval * task.n_substeps / seconds
            rows.append(measure_all(env) | {"steps_per_s": speed})
            shown = "  ".join(f"{name} {value:.6g}" for name, value in rows[-1].items())
            print(f"{decision * task.n_substeps:>9} steps  {shown}", flush=True)
    env.close()
    first, last = rows[min(1, len(rows) - 1)], rows[-1]
    drift = max(row["mass_drift"] for row in rows)
    print(f"{episodes} episodes, {diverged} diverged, largest drift of mass {drift:.2g}")
    grown = [n for n, most in LIMITS.items() if last[n] - first[n] > most]
    if grown or diverged or drift > MAX_DRIFT:
        sys.exit(f"not flat: {grown}, diverged: {diverged}, drift of mass: {drift:.2g}")


if __name__ == "__main__":
    main()
