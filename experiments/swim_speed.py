"""How fast the fish swims, against resolution: ``python -m experiments.swim_speed``.

The paper's Task 0: a NACA0012 fish starts in still water at Re_f = 7000 and swims straight. Speed
is the head-on displacement of the centre of mass over each tail beat. Too coarse a body does not
fail, it swims slowly, and nothing else tells; this is the check that a preset is honest.
"""

import argparse
import json
from math import pi
from pathlib import Path

import matplotlib as mpl
import torch
from tqdm import tqdm

from fishrl.physics import InPlaceSolver, Scales
from fishrl.physics.cases import make_swimmer_config
from fishrl.physics.motion import Commanded, Free, Motion

REYNOLDS = 7000.0


def measure_speed(
    body_length: int, num_beats: int, *, motion: Motion, max_wall_speed: float
) -> list[float]:
    """Return the forward speed in L / T of each tail beat.

    Args:
        body_length: L in nodes; the tank is 10 L x 5 L.
        num_beats: tail beats to swim.
        motion: free, or its heading held by the command.
        max_wall_speed: Mach budget, nodes per step.
    """
    scales = Scales.from_budget(
        body_length=body_length, reynolds=REYNOLDS, max_wall_speed=max_wall_speed
    )
    config = make_swimmer_config(scales, motion=motion)
    solver = InPlaceSolver(config=config, num_envs=1, frequency=1.0 / scales.period)
    start = torch.tensor([[8.5 * body_length, 2.5 * body_length]], dtype=torch.float64)
    solver.reset_(torch.ones(1, dtype=torch.bool), start, torch.full((1,), pi))
    speeds, before = [], start
    for _ in tqdm(range(num_beats), desc=f"L = {body_length}, {_name(motion)}", unit="T"):
        solver.advance_(scales.period)
        after = solver.body.position.clone()
        speeds.append(float((before - after)[0, 0]) / body_length)
        before = after
    if solver.is_diverged().any():
        raise RuntimeError(f"the flow diverged at L = {body_length}: lower --max-wall-speed")
    return speeds


def _name(motion: Motion) -> str:
    return type(motion).__name__.lower()


def draw(results: dict[str, list[float]], path: Path) -> None:
    """Draw forward speed against time: a panel per heading mode, a line per resolution."""
    mpl.use("Agg")
    import matplotlib.pyplot as plt

    modes = list(dict.fromkeys(name.split(", ")[1] for name in results))
    figure, panels = plt.subplots(
        1, len(modes), figsize=(9.0, 3.8), sharey=True, squeeze=False, layout="constrained"
    )
    for axes, mode in zip(panels[0], modes, strict=True):
        for name, speeds in results.items():
            length, own = name.split(", ")
            if own == mode:
                axes.plot(range(1, len(speeds) + 1), speeds, marker="o", ms=3.5, label=length)
        axes.set(xlabel="time  t / T", title=f"heading {mode}", ylim=(0.0, None))
        axes.grid(alpha=0.3)
    panels[0][0].set_ylabel("forward speed over each beat  U T / L")
    panels[0][-1].legend(title="L in nodes", fontsize=8)
    figure.suptitle("NACA0012 fish from rest, Re = L² / (T ν) = 7000", fontsize=11)
    figure.savefig(path, dpi=130)


def main() -> None:
    """Measure, print a table, write JSON and a figure."""
    parser = argparse.ArgumentParser(description="Measure the swimming speed against resolution.")
    parser.add_argument("--body-lengths", type=int, nargs="+", default=[40, 50, 64, 80, 100])
    parser.add_argument("--beats", type=int, default=8)
    parser.add_argument("--max-wall-speed", type=float, default=0.07)
    parser.add_argument("--folder", type=Path, default=Path("runs/swim_speed"))
    options = parser.parse_args()
    results: dict[str, list[float]] = {}
    for motion in (Free(), Commanded()):
        for body_length in options.body_lengths:
            results[f"{body_length}, {_name(motion)}"] = measure_speed(
                body_length,
                options.beats,
                motion=motion,
                max_wall_speed=options.max_wall_speed,
            )
    print("| L (nodes), heading | " + " | ".join(f"{t + 1} T" for t in range(options.beats)) + " |")
    print("|---" * (options.beats + 1) + "|")
    for name, speeds in results.items():
        print(f"| {name} | " + " | ".join(f"{speed:.3f}" for speed in speeds) + " |")
    options.folder.mkdir(parents=True, exist_ok=True)
    (options.folder / "swim_speed.json").write_text(json.dumps(results, indent=2) + "\n")
    draw(results, options.folder / "swim_speed.png")
    print(f"written to {options.folder}")


if __name__ == "__main__":
    main()
