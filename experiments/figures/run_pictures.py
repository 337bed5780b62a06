"""The pictures of a run: episodes of its policy and its learning curve."""

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import TransformedEnv

from experiments.figures.learning_curve import write_learning_curve
from experiments.figures.trajectories import write_trajectories
from fishrl.envs.episodes import Policy
from fishrl.envs.scene import Frame
from fishrl.viewer import (
    Recording,
    ViewerSettings,
    make_scene,
    name_flows,
    record_episodes,
    start_drawing,
)
from fishrl.viewer.film import write_animation, write_flow, write_snapshots

#: Number of flows kept in ``capture.rrd``.
_MAX_FLOWS = 3
#: Recorded duration of episodes of tasks without a goal, T.
_MAX_PERIODS = 20.0


def record_run(
    folder: Path,
    env: TransformedEnv,
    policy: Policy,
    starts: TensorDictBase,
    *,
    settings: ViewerSettings,
    baselines: Mapping[str, float],
    on_episodes: Callable[[int], None],
) -> list[Path]:
    """Record the policy of a run from ``starts`` ``[E]``, draw its pictures and return the files.

    Args:
        folder: of the run; ``capture.rrd`` holds the first flows.
        env: of the training.
        policy: that it learned.
        starts: one episode each.
        settings: of the drawing.
        baselines: see ``write_learning_curve``.
        on_episodes: called with the number of episodes that have just ended.
    """
    task, scene = env.base_env.task, make_scene(env, vorticity_limit=settings.vorticity_limit)
    flows, max_decisions = list(range(min(_MAX_FLOWS, len(starts)))), None
    if scene.goal is None:
        starts, max_decisions = starts[flows], math.ceil(_MAX_PERIODS / task.interval_T - 1e-9)
    recordings = [Recording(scene=scene) for _ in range(len(starts))]

    def count(running: Tensor, step: TensorDictBase) -> None:
        on_episodes(int(((running >= 0) & step["next", "done"].squeeze(-1)).sum()))

    with start_drawing(
        scene,
        flows=name_flows(task, flows, starts),
        save=folder / "capture.rrd",
        field_format=settings.field_format,
    ) as drawing:

        def give(start: int, frame: Frame) -> None:
            if scene.goal is not None:
                recordings[start].frames.append(frame)
            if start in flows:
                drawing.draw(start, frame)

        episodes = record_episodes(
            env,
            policy,
            starts,
            scene=scene,
            give=give,
            frames_per_T=settings.frames_per_T,
            max_decisions=max_decisions,
            on_step=count,
        )
    for recording, has_succeeded in zip(recordings, episodes.succeeded.tolist(), strict=True):
        recording.has_succeeded = has_succeeded
    return [folder / "capture.rrd", *write_run_pictures(folder, recordings, baselines=baselines)]


def write_run_pictures(
    folder: Path, recordings: Sequence[Recording], *, baselines: Mapping[str, float]
) -> list[Path]:
    """Write the learning curve and, if the task has a goal, pictures of the episodes.

    All ``recordings`` go into ``trajectories.png``; the first one that succeeded (else the first
    one) into the flow pictures and the animation. Returns the files in the order written.
    """
    written = []
    if (folder / "metrics.csv").is_file():
        written.append(folder / "learning_curve.png")
        write_learning_curve(folder / "metrics.csv", written[-1], baselines=baselines)
    if recordings[0].scene.goal is None:
        return written
    shown = next((r for r in recordings if r.has_succeeded), recordings[0])
    names = ("trajectories.png", "vorticity_sequence.png", "vorticity_last.png", "capture.gif")
    trajectories, sequence, last, animation = (folder / name for name in names)
    write_trajectories(recordings, trajectories)
    write_snapshots(shown, sequence)
    write_flow(shown, last)
    write_animation(shown, animation)
    return [*written, trajectories, sequence, last, animation]
