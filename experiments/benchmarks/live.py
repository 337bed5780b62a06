"""What a live view costs: ``python -m experiments.benchmarks.live``.

The same flows decide in turn with and without it. Nothing is left out (``live_share=1``), and
nobody looks; a window on this machine would take cores of its own. Other load changes the time of
a decision, and hardly the processor time of this process; the flows have processes of their own.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

from experiments.benchmarks.machine import describe_machine
from experiments.command_line import plain_errors, set_up_logging
from experiments.config import build, load_config
from fishrl.envs import make_env
from fishrl.viewer import LiveView, ViewerSettings


def measure(
    task: Any, *, num_envs: int, pairs: int, compile: bool = True, port: int = 9876
) -> dict[str, list[tuple[float, float]]]:
    """Time decisions of random fish in pairs: one that nobody sees, one with a live view of flow 0.

    Args:
        task: what the fish do.
        num_envs: flows that advance together.
        pairs: how many count; one more runs before them.
        compile: compile the flow solver.
        port: of the server.

    Returns:
        For each decision of all flows together, in the order of pairs, its seconds and those of
        the processor: ``without`` and ``live``.

    Raises:
        ValueError: for fewer than one pair.
    """
    if pairs < 1:
        raise ValueError(f"pairs = {pairs}: must be at least 1")
    seconds: dict[str, list[tuple[float, float]]] = {"without": [], "live": []}
    looks = task.checks_per_action
    env = make_env(task=task, num_envs=num_envs, compile=compile, frames_per_action=looks)
    live = LiveView(env, ViewerSettings(port=port, live_share=1.0))
    look, state = env.base_env.on_frame, env.reset()
    for _ in range(pairs + 1):
        for name, times in seconds.items():
            env.base_env.on_frame = look if name == "live" else None
            start, busy = time.perf_counter(), time.process_time()
            step, state = env.step_and_maybe_reset(env.rand_action(state))
            if name == "live":
                live.settle(step)
            times.append((time.perf_counter() - start, time.process_time() - busy))
    live.close()
    env.close()
    return {name: times[1:] for name, times in seconds.items()}


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description="Measure what a live view costs.")
    parser.add_argument("--preset", default="small")
    parser.add_argument("--num-envs", type=int, default=4, help="flows, of which one is shown")
    parser.add_argument("--pairs", type=int, default=5)
    arguments = parser.parse_args()
    set_up_logging()
    with plain_errors():
        task = build(load_config("train", [f"preset={arguments.preset}"]).task)
        seconds = measure(task, num_envs=arguments.num_envs, pairs=arguments.pairs)
    print(f"{arguments.preset}, {arguments.num_envs} flows, best of {arguments.pairs} decisions")
    print(", ".join(f"{key}: {value}" for key, value in describe_machine().items()))
    for name, times in seconds.items():
        wall, busy = (min(column) for column in zip(*times, strict=True))
        every = " ".join(f"{one:.2f}" for one, _ in times)
        print(f"{name:<8} {wall:.3f} s, of the processor {busy:.3f} s; all: {every}")


if __name__ == "__main__":
    main()
