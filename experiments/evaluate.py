"""See how well a fish does: ``python -m experiments.evaluate checkpoint=runs/<name> episodes=32``.

``policy=random|pursuit|intercept`` evaluates a hand-written fish instead.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from experiments.configuration import build, to_plain
from experiments.program import program
from experiments.settings import EvaluateConfig
from experiments.stored_runs import read_task
from fishrl import training
from fishrl.envs import make_env as make_real_env
from fishrl.training import Observer
from fishrl.training.progress import Progress
from fishrl.viewer import LiveView


class LiveObserver(Observer):
    """Streams flows to a viewer if ``live`` is set.

    Args:
        config: the settings.
    """

    def __init__(self, config: EvaluateConfig) -> None:
        self._config = config
        self._live: LiveView | None = None

    def begin(self, env: Any) -> None:
        """Start the live view."""
        if self._config.live:
            self._live = LiveView(env, self._config)

    def settle(self, step: Any) -> None:
        """Show a decision."""
        if self._live is not None:
            self._live.settle(step)

    def close(self) -> None:
        """End the live view."""
        if self._live is not None:
            self._live.close()


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
    task = build(config.task)
    result = training.evaluate(
        str(config.policy) if config.checkpoint is None else Path(config.checkpoint),
        task=task,
        recognition=config.recognition,
        episodes=config.episodes,
        num_envs=config.num_envs,
        seed=config.seed,
        device=config.device,
        compile=config.compile,
        make_env=make_env or make_real_env,
        observer=LiveObserver(config),
        progress=progress,
    )
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
