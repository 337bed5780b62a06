"""Write the policy of a run into a small folder with a model card."""

import math
import shutil
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml

from fishrl import __version__
from fishrl.envs import AbstractTask
from fishrl.files import claim, write_whole
from fishrl.pages import write_csv, write_table
from fishrl.settings import describe, flatten
from fishrl.training.checkpoint import Checkpoint, save_checkpoint, write_sums
from fishrl.training.logger import read_rows
from fishrl.training.plan import Plan
from fishrl.training.policies import load_policy
from fishrl.training.policy_spec import PolicySpec
from fishrl.training.run_folder import RunFolder, read_config, read_summary, write_json

#: Settings on the card, next to those of starts.
_CONDITIONS = ("body_length", "reynolds", "stream.speeds_bl", "stream.diameter_bl")
#: Results on the card, by their names in ``summary.json``.
_RESULTS = {
    "success_rate": "success rate",
    "mean_return": "mean return",
    "mean_length_T": "mean length [T]",
    "mean_time_to_success_T": "mean time to success [T]",
    "episodes": "episodes",
}


def export_policy(
    run: str | Path,
    folder: str | Path,
    *,
    title: str | None = None,
    revision: str | None = None,
) -> Path:
    """Write the best policy of a run, without optimiser and replay buffer.

    The folder is a checkpoint: ``load_policy``, ``evaluate`` and the programs take it. It holds the
    weights with their SHA-256, the settings, the run's classifier if it has one, ``metrics.csv``
    and ``summary.json``, and a model card, ``README.md``.

    Args:
        run: run folder.
        folder: folder to write; must not exist, or be empty.
        title: title of the card; by default the name of the folder.
        revision: commit of the code that exports it, for the card.

    Returns:
        The folder.

    Raises:
        ValueError: if there is no such run or checkpoint, or the folder holds something.
    """
    folder = Path(folder).expanduser()
    with claim(folder), ExitStack() as failed:
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise ValueError(f"folder = {folder}: exists; name a new one")
        failed.callback(shutil.rmtree, folder, ignore_errors=True)
        _export(RunFolder(Path(run).expanduser()), folder, title=title, revision=revision)
        failed.pop_all()
    return folder


def _export(source: RunFolder, folder: Path, *, title: str | None, revision: str | None) -> None:
    best = Checkpoint.find(source.path)
    plan = Plan.from_config(best.config)
    if source.config.is_file():  # its settings may have changed since the best checkpoint
        plan = Plan.from_config(read_config(source.config))
    actor = load_policy(best.path)
    spec = PolicySpec.for_task(plan.task, has_labels=plan.recognition is not None)
    plan = replace(plan, folder="runs", name=folder.name)  # not where it was on this machine
    config = plan.to_config()
    save_checkpoint(folder, {"actor": actor}, spec=spec, frames=best.frames, config=config)
    if plan.recognition is not None:
        plan.recognition.keep(folder)
    summary = read_summary(source.summary)
    if summary:
        write_json(folder / source.summary.name, summary)
    if source.metrics.is_file() and (rows := read_rows(source.metrics)):
        short = ([_shorten(value) for value in row.values()] for row in rows)
        write_csv(folder / source.metrics.name, list(rows[0]), short)
    write_sums(folder)
    card = _write_card(
        plan, summary, title=title or folder.name, frames=best.frames, revision=revision
    )
    write_whole(folder / "README.md", card)


def describe_conditions(task: AbstractTask) -> dict[str, str]:
    """Return, for a card, what success is, and the conditions that the policy was trained in."""
    limit_T = f"{task.time_limit * task.interval_T:.3g} T"
    aim = f"`{task.success}` within {limit_T}" if task.success else f"lasts {limit_T}"
    ranges = {
        name: str(value).replace("'", "")
        for name, value in flatten(describe(task)).items()
        if name in _CONDITIONS or name.startswith("start_")
    }
    words = ", ".join(f"{name} {value}" for name, value in ranges.items())
    return {"success, in training": aim, "trained in": words}


def _shorten(cell: str) -> str:
    """Write a number of the learning curve to seven digits, single precision."""
    return f"{float(cell):.7g}" if "." in cell else cell


def _write_card(
    plan: Plan, summary: Mapping[str, Any], *, title: str, frames: int, revision: str | None
) -> str:
    """Return the model card of a policy that was saved after ``frames``, as Markdown."""
    header = {"library_name": "fishrl", "license": "mit", "tags": ["reinforcement-learning"]}
    labels = "none" if plan.recognition is None else type(plan.recognition).__name__.lower()
    about = {
        "task": type(plan.task).__name__,
        "algorithm": type(plan.algorithm).__name__,
        "seed": plan.seed,
        "env frames": f"{frames:,} of {plan.total_frames:,}",
        **describe_conditions(plan.task),
        "recognition of the flow": labels,
        "exported with fishrl": " ".join(filter(None, (__version__, revision))),
    }
    bullets = "\n".join(f"- {name}: {value}" for name, value in about.items())
    # a setting a line: none ends the block of code
    settings = yaml.safe_dump(plan.to_config(), sort_keys=False, allow_unicode=True, width=math.inf)
    return f"""---
{yaml.safe_dump(header, sort_keys=False)}---
# {title}

{bullets}

Final evaluation from fixed starts that were not used to choose it:

{write_results(summary)}
`metrics.csv` holds the learning curve. Settings:

```yaml
{settings}```

`fishrl.training.load_policy(<this folder>)` loads the policy; `fishrl score policy=<this folder>
task=<frozen task>` scores it on held-out starts.
"""


def write_results(summary: Mapping[str, Any]) -> str:
    """Return the table of a card: results of a policy, and of the baselines of its run."""
    names = ["policy", *(summary.get("baselines") or [])]
    prefixes = ["", *(f"{name}_" for name in names[1:])]
    rows = [
        [label, *(_show(summary.get(prefix + key)) for prefix in prefixes)]
        for key, label in _RESULTS.items()
    ]
    return write_table(["", *names], rows)


def _show(value: Any) -> str:
    return "–" if value is None or value != value else f"{value:.4g}"
