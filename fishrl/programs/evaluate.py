"""Evaluate a policy: ``fishrl evaluate policy=runs/<name> episodes=32``.

``policy=random|pursuit|intercept`` evaluates a baseline instead.
"""

from typing import Any

from fishrl.files import claim_file
from fishrl.programs.live import LiveView
from fishrl.programs.program import program, take
from fishrl.programs.statistics import find_share, show
from fishrl.programs.stored_task import POLICY
from fishrl.settings import to_plain
from fishrl.training import evaluate
from fishrl.training.progress import Progress
from fishrl.training.run_folder import write_json
from fishrl.viewer import ViewerSettings


@program(evaluate, ViewerSettings, **POLICY)
def main(*, preset: str | None = None, save: str | None = None, **given: Any) -> None:
    """Evaluate, print the result, and store it where ``save`` says.

    Args:
        preset: name of a preset; only its task is used.
        save: file for the result and all these settings as JSON, or nothing.
        **given: arguments of ``evaluate`` and ``ViewerSettings``.
    """
    settings = to_plain({"preset": preset, "save": save, **given})
    policy, view = given["policy"], take(ViewerSettings, given)
    live = LiveView(view, num_flows=min(given["flows"].num_envs, given["episodes"]))
    about = {"policy": policy, "task": type(given["task"]).__name__, "preset": preset}
    with claim_file(save) as path:
        with Progress() as progress:
            found = evaluate(**given, callbacks=[progress, live])
        result = {**about, "seed": given["seed"], **found}
        if path is not None:
            write_json(path, result | {"settings": settings})
    for name, value in result.items():
        shown = show(value, ".3f") if isinstance(value, float) else value
        if name == "success_rate":
            shown = find_share(round(value * result["episodes"]), result["episodes"]).show(".3f")
        print(f"{name:<24}{shown}")
