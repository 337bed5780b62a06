"""Let one policy of the zoo swim an episode, and film it."""

import gc
import logging
import math
import sys
import time
from contextlib import chdir, closing
from tempfile import TemporaryDirectory

import torch

from fishrl.envs import make_env
from fishrl.training.evaluation import fixed_starts
from fishrl.viewer import Recording, make_scene, record_episodes
from fishrl.viewer.film import FILMS, render_frames, write_flow
from fishrl.zoo import load_policy, load_recognition

_FRAMES_PER_T = 4

logger = logging.getLogger(__name__)


def swim(name: str, *, periods: float, compile: bool = True) -> tuple[Recording, str]:
    """Let a policy of the zoo swim one episode.

    Args:
        name: name of the policy.
        periods: T after which the recording ends at the latest.
        compile: compile the flow step.

    Returns:
        The recording, and how the episode ended.
    """
    policy, task = load_policy(name)
    with TemporaryDirectory() as place, chdir(place):  # where developed wakes are stored
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
    if not bool(episodes.terminated):
        return recording, "still swims"
    return recording, "succeeded" if bool(episodes.succeeded) else "failed"


def film(name: str, path: str, *, periods: float, compile: bool = True) -> None:
    """Film a policy of the zoo in a process of its own.

    Args:
        name: name of the policy.
        path: path of the films and the picture, without suffix.
        periods: T after which the film ends at the latest.
        compile: compile the flow step.
    """
    logging.basicConfig(format="%(message)s", stream=sys.stdout)
    logger.setLevel(logging.INFO)
    logging.getLogger("torchrl").setLevel(logging.ERROR)  # on other builds of torch
    torch.set_num_threads(1)
    gc.freeze()  # what imports made is kept to the end
    gc.enable()
    began = time.perf_counter()
    recording, ending = swim(name, periods=periods, compile=compile)
    swam = time.perf_counter()
    write_flow(recording, f"{path}.png")
    pictures = render_frames(recording)
    for suffix, write in FILMS.items():
        write(recording, f"{path}{suffix}", pictures=pictures)
    logger.info(
        "%s.mp4, .gif, .png: zoo/%s %s after %.1f T; computed in %.0f s, drawn in %.0f s",
        *(path, name, ending, recording.frames[-1].time),
        *(swam - began, time.perf_counter() - swam),
    )
