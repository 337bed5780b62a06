"""Watch trained policies swim: ``python -m fishrl.demo``.

Policies of ``fishrl.zoo``, trained before. Their films, recorded when they were added to the zoo,
are written at once. Then each swims again in a flow that is computed here and now; an MP4, a GIF
and a picture of each are written.
"""

from __future__ import annotations

import argparse
import logging
import math
import shutil
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing
from multiprocessing import get_context
from pathlib import Path

import torch

from fishrl.envs import make_env
from fishrl.training.evaluation import fixed_starts
from fishrl.viewer import Recording, make_scene, record_episodes
from fishrl.viewer.film import FILMS, render_frames, write_flow
from fishrl.zoo import find_policy, load_policy, load_recognition

#: Policy, name of its files, and after how many T its film ends.
SHOWS = (("predation_small", "catching_food", 30.0), ("gait_small", "holding_station", 12.0))
_FRAMES_PER_T = 6

logger = logging.getLogger(__name__)


def show(name: str, title: str, periods: float, *, folder: Path, compile: bool = True) -> str:
    """Let a policy of the zoo swim one episode, and film it.

    Args:
        name: of the policy.
        title: of the files.
        periods: T after which the film ends at the latest.
        folder: to write into.
        compile: compile the flow step.

    Returns:
        What happened, in a line.
    """
    began = time.perf_counter()
    policy, task = load_policy(name)
    env = make_env(
        task=task,
        num_envs=1,
        recognition=load_recognition(name),
        compile=compile,
        frames_per_action=task.checks_per_action,
    )
    with closing(env):
        recording = Recording(scene=make_scene(env))
        episodes = record_episodes(
            env,
            policy,
            fixed_starts(env.base_env.task, 1, seed=0),
            scene=recording.scene,
            give=lambda start, frame: recording.frames.append(frame),
            frames_per_T=_FRAMES_PER_T,
            max_decisions=math.ceil(periods / task.interval_T),
        )
    swam = time.perf_counter()
    write_flow(recording, folder / f"{title}.png")
    pictures = render_frames(recording)
    for ending, write in FILMS.items():
        write(recording, folder / f"{title}{ending}", pictures=pictures)
    ending = "still swims"
    if bool(episodes.terminated):
        ending = "succeeded" if bool(episodes.succeeded) else "failed"
    return (
        f"{folder / title}.mp4, .gif, .png: zoo/{name} {ending} after "
        f"{recording.frames[-1].time:.1f} T; computed in {swam - began:.0f} s, "
        f"drawn in {time.perf_counter() - swam:.0f} s"
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line, by default that of the process."""
    parser = argparse.ArgumentParser(prog="python -m fishrl.demo", description=__doc__)
    parser.add_argument("--folder", default="demo", help="to write into (default: demo)")
    parser.add_argument("--eager", action="store_true", help="do not compile the flow step")
    options = parser.parse_args(arguments)
    logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stdout)
    folder = Path(options.folder)
    folder.mkdir(parents=True, exist_ok=True)
    for name, title, _ in SHOWS:
        film = shutil.copy(find_policy(name) / "film.mp4", folder / f"{title}_recorded.mp4")
        logger.info("%s: recorded film of zoo/%s", film, name)
    logger.info(
        "now in a flow computed here: about a minute, most of it compilation, the first time"
    )
    with ProcessPoolExecutor(len(SHOWS), get_context("spawn"), torch.set_num_threads, (1,)) as pool:
        running = [
            pool.submit(show, *entry, folder=folder, compile=not options.eager) for entry in SHOWS
        ]
        for done in running:
            logger.info(done.result())


if __name__ == "__main__":
    main()
