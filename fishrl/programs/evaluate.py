"""Evaluate a policy: ``fishrl evaluate checkpoint=runs/<name> episodes=32``.

``policy=random|pursuit|intercept`` evaluates a baseline instead.
"""

from pathlib import Path
from typing import Any

from pydantic import PositiveInt

from fishrl.programs.live import LiveView
from fishrl.programs.policy_settings import PolicySettings, read_task
from fishrl.programs.program import program
from fishrl.programs.statistics import find_share, show
from fishrl.settings import describe
from fishrl.training import evaluate as run_evaluation
from fishrl.training.callback import SILENT, Callback
from fishrl.training.progress import Progress
from fishrl.training.run_folder import write_json
from fishrl.viewer import ViewerSettings, check_folder


class EvaluateConfig(PolicySettings, ViewerSettings):
    """Settings of an evaluation.

    Args:
        episodes: fixed starts, one episode each; with ``seed=0`` those of every run's final
            evaluation, with 1 those that selected its checkpoint.
        save: file for the result and all these settings as JSON, or nothing.
    """

    episodes: PositiveInt = 32
    save: str | None = None


def evaluate(config: EvaluateConfig, *, progress: Callback = SILENT) -> dict[str, Any]:
    """Run one episode from each of the fixed starts, and return the result with its policy."""
    live = LiveView(config, num_flows=min(config.flows.num_envs, config.episodes))
    result = run_evaluation(
        config.source,
        task=config.task,
        recognition=config.recognition,
        episodes=config.episodes,
        flows=config.flows,
        seed=config.seed,
        callbacks=[progress, live],
    )
    about = {"policy": config.checkpoint or config.policy, "task": type(config.task).__name__}
    return {**about, "preset": config.preset, "seed": config.seed, **result}


@program(EvaluateConfig, groups={"task": "predation", "preset": None}, stored=read_task)
def main(settings: EvaluateConfig) -> None:
    """Evaluate, print the result, and store it where ``save`` says."""
    path = None if settings.save is None else Path(settings.save).expanduser()
    if path is not None:
        check_folder(path)
    with Progress() as progress:
        result = evaluate(settings, progress=progress)
    for name, value in result.items():
        shown = show(value, ".3f") if isinstance(value, float) else value
        if name == "success_rate":
            shown = find_share(round(value * result["episodes"]), result["episodes"]).show(".3f")
        print(f"{name:<24}{shown}")
    if path is not None:
        write_json(path, result | {"settings": describe(settings)})
