"""Evaluate a policy: ``python -m experiments.evaluate checkpoint=runs/<name> episodes=32``.

``policy=random|pursuit|intercept`` evaluates a baseline instead.
"""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from omegaconf import MISSING

from experiments.live import LiveObserver
from experiments.program import program
from experiments.train_settings import read_task
from fishrl.bounds import bounded
from fishrl.envs import AbstractTask, make_env
from fishrl.training import evaluate as run_evaluation
from fishrl.training.description import make, to_plain
from fishrl.training.progress import Progress
from fishrl.training.run_folder import write_json
from fishrl.viewer import ViewerSettings, check_folder


@dataclass(frozen=True, kw_only=True)
class EvaluateConfig(ViewerSettings):
    """Settings of an evaluation, besides those of ``ViewerSettings``.

    Args:
        task: ``_target_`` and arguments of the task; a checkpoint brings its own unless ``task``
            or ``preset`` is given, and ``task.<argument>`` changes it.
        preset: name of the preset.
        checkpoint: run folder or checkpoint of the policy to evaluate.
        policy: baseline to evaluate instead, see ``fishrl.training.baselines``.
        recognition: as for training; a checkpoint brings its own.
        episodes: fixed starts, one episode each.
        num_envs: flows that advance together.
        seed: of the starts and of random actions; 0 gives those of every run's final evaluation, 1
            those that selected its checkpoint.
        device: cpu or cuda.
        compile: compile the flow solver.
        save: file for the result and all these settings as JSON, or nothing.
    """

    task: Any = MISSING
    preset: str | None = None
    checkpoint: str | None = None
    policy: str | None = None
    recognition: str | None = None
    episodes: int = bounded(32, least=1)
    num_envs: int = bounded(16, least=1)
    seed: int = 0
    device: str = "cpu"
    compile: bool = True
    save: str | None = None

    def __post_init__(self) -> None:
        """Check the bounds, and that there is one policy."""
        super().__post_init__()
        if (self.checkpoint is None) == (self.policy is None):
            raise ValueError(
                "give one of checkpoint=<run folder> and policy=<baseline>, such as policy=random"
            )


def evaluate(
    config: EvaluateConfig, *, make_env: Any = make_env, progress: Progress | None = None
) -> dict[str, Any]:
    """Run one episode from each of the fixed starts.

    Returns:
        What ``fishrl.training.evaluate`` returns, and which policy it was.

    Raises:
        ValueError: for invalid settings, and checkpoints that do not fit the task.
    """
    task = make(config.task, kind=AbstractTask)
    result = run_evaluation(
        str(config.policy) if config.checkpoint is None else Path(config.checkpoint),
        task=task,
        recognition=config.recognition,
        episodes=config.episodes,
        num_envs=config.num_envs,
        seed=config.seed,
        device=config.device,
        compile=config.compile,
        make_env=make_env,
        observer=LiveObserver(config, num_flows=min(config.num_envs, config.episodes)),
        progress=progress,
    )
    return {
        "policy": config.checkpoint or config.policy,
        "task": type(task).__name__,
        "preset": config.preset,
        "seed": config.seed,
        **result,
    }


def check_file(path: Path) -> Path:
    """Return the path of a file for the result, if it can be written.

    Raises:
        ValueError: if not.
        FileNotFoundError: if there is no folder for it.
    """
    check_folder(path)
    if path.is_dir() or not os.access(path.absolute().parent, os.W_OK | os.X_OK):
        raise ValueError(f"save={path}: cannot be written; choose another file")
    return path


@program(EvaluateConfig, groups={"task": "predation", "preset": None}, stored=read_task)
def main(settings: EvaluateConfig) -> None:
    """Evaluate, print the result, and store it where ``save`` says."""
    path = None if settings.save is None else check_file(Path(settings.save).expanduser())
    with Progress() as progress:
        result = evaluate(settings, progress=progress)
    for name, value in result.items():
        shown = f"{value:.3f}" if isinstance(value, float) else value
        print(f"{name:<24}{shown}")
    if path is not None:
        write_json(path, result | {"settings": to_plain(asdict(settings))})


if __name__ == "__main__":
    main()
