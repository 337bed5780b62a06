"""See how well a fish does: ``python -m experiments.evaluate checkpoint=runs/<name> episodes=32``.

``policy=random|pursuit|intercept`` evaluates a hand-written fish instead.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from experiments.configuration import build, to_plain
from experiments.program import program
from experiments.settings import EvaluateConfig
from experiments.stored_runs import read_task
from fishrl.training.progress import Progress


def evaluate(
    config: EvaluateConfig, *, make_env: Any = None, progress: Progress | None = None
) -> dict[str, Any]:
    """Run one episode from each of the fixed starts.

    Args:
        config: the settings.
        make_env: makes the env of a task; by default ``fishrl.envs.flow_env.make_env``.
        progress: the bar, if there is one already.

    Returns:
        ``success_rate``, ``mean_return``, ``mean_length_T``, ``mean_time_to_success_T``,
        ``episodes``, ``diverged``, and which fish it was.

    Raises:
        ValueError: for settings that cannot be, and checkpoints that do not fit.
    """
    from experiments.settings import check_device
    from fishrl.envs import make_env as make_real_env
    from fishrl.training.baselines import make_policy
    from fishrl.training.evaluation import Evaluator, fixed_starts
    from fishrl.training.policies import load_policy
    from fishrl.training.recognition import Recognition
    from fishrl.viewer import LiveView

    progress = progress or Progress(is_shown=False)
    check_device(config.device)
    recognition = Recognition(build(config.task), config.recognition)
    task, policy = recognition.task, None
    if config.checkpoint is not None:
        policy = load_policy(
            config.checkpoint, task=task, has_labels=recognition.is_told, device=config.device
        )
    else:
        policy = make_policy(str(config.policy), task=task, seed=config.seed)
    progress.rename("compilation" if config.compile else "set-up")
    env = recognition.equip(make_env or make_real_env)(
        task=task,
        num_envs=min(config.num_envs, config.episodes),
        seed=config.seed,
        device=config.device,
        compile=config.compile,
        frames_per_action=task.checks_per_action if config.live else 1,
    )
    evaluator = Evaluator(env, decision_T=task.interval_T)
    progress.start("evaluation", total=config.episodes)
    with ExitStack() as stack:
        stack.callback(env.close)
        live = None
        if config.live:
            live = LiveView(env, config)
            stack.callback(live.close)
        result: dict[str, Any] = evaluator.run(
            policy,
            starts=fixed_starts(task, config.episodes, seed=config.seed),
            on_episodes=progress.advance,
            on_step=None if live is None else live.settle,
        ).metrics()
    return {
        "fish": config.checkpoint or config.policy,
        "task": type(task).__name__,
        "preset": config.preset,
        "seed": config.seed,
        **result,
    }


def check_result(save: str) -> Path:
    """Return the path of a file for the result, if it can be written.

    Raises:
        ValueError: if not.
        FileNotFoundError: if there is no folder for it.
    """
    from fishrl.viewer import check_folder

    path = check_folder(Path(save).expanduser())
    if path.is_dir():
        raise _unwritable(path, "it is a folder")
    if not os.access(path.absolute().parent, os.W_OK | os.X_OK):
        raise _unwritable(path, "no write permission")
    return path


def write_result(path: Path, values: Mapping[str, Any]) -> None:
    """Write a result.

    Raises:
        ValueError: if it cannot be written.
    """
    from fishrl.training.run_folder import write_json

    try:
        write_json(path, values)
    except OSError as error:
        raise _unwritable(path, error.strerror or str(error)) from error


def _unwritable(path: Path, reason: str) -> ValueError:
    return ValueError(
        f"save={path}: cannot be written ({reason}); choose another file or change the permissions"
    )


@program(EvaluateConfig, groups={"task": "predation", "preset": None}, stored=read_task)
def main(settings: EvaluateConfig) -> None:
    """Evaluate, print the result, and store it where ``save`` says."""
    path = None if settings.save is None else check_result(settings.save)
    with Progress() as progress:
        result = evaluate(settings, progress=progress)
    for name, value in result.items():
        shown = f"{value:.3f}" if isinstance(value, float) else value
        print(f"{name:<24}{shown}")
    if path is not None:
        write_result(path, result | {"settings": to_plain(settings)})


if __name__ == "__main__":
    main()
