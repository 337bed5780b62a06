"""Evaluate policies of the zoo again, from the starts of their cards, and renew the cards' results.

    python studies/zoo/evaluate.py                 # all of them
    python studies/zoo/evaluate.py gait_bend ...

A card then says with which commit. Baselines of the cards are evaluated again, too.
"""

import json
import re
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

from fishrl.envs import Flows, make_task
from fishrl.programs.export_policy import read_revision
from fishrl.programs.score import score
from fishrl.training import evaluate, load_plan
from fishrl.training.checkpoint import write_sums
from fishrl.training.export import write_results
from fishrl.training.run_folder import write_json
from fishrl.zoo import find_policy, list_policies

#: Policies that were trained for 20 T and whose cards have results of 40 T.
LONGER = dict.fromkeys(("gait_bend_all", "gait_bend_blind", "gait_bend_blind_line", "gait_bend_line", "gait_bend_wide"), 321)


def renew(name: str, commit: str) -> None:
    """Evaluate one policy, and write its ``summary.json`` and the table of its card."""
    folder, plan = find_policy(name), load_plan(f"zoo/{name}")
    summary, task = json.loads((folder / "summary.json").read_text()), plan.task
    if version := summary.get("version"):  # of the benchmark
        summary = {**score(f"zoo/{name}", task=make_task(version)).metrics, "version": version}
        write_card(folder, summary, f"On the {summary['episodes']} test starts of `{version}`, at commit {commit[:8]}")
        return
    task = replace(task, time_limit=LONGER.get(name, task.time_limit))
    flows = Flows(num_envs=min(16, summary["episodes"]))
    baselines = [key.removesuffix("_success_rate") for key in summary if key.endswith("_success_rate")]
    for policy in ("", *baselines):
        found = evaluate(
            policy or f"zoo/{name}",
            task=task,
            recognition=plan.recognition,
            episodes=summary["episodes"],
            flows=flows,
        )
        prefix = f"{policy}_" if policy else ""
        print(name, policy or "policy", summary[f"{prefix}mean_length_T"], found, flush=True)
        summary |= {prefix + key: value for key, value in found.items()}
    summary |= {"baselines": baselines, "evaluated_at": commit}
    when = f"for 40 T (`task.time_limit={LONGER[name]}`) " if name in LONGER else ""
    words = f"Evaluation {when}from fixed starts that were not used to choose it, at commit {commit[:8]}"
    write_card(folder, summary, words)


def write_card(folder: Path, summary: dict[str, Any], words: str) -> None:
    """Write ``summary.json`` and the table of a card, below ``words``."""
    write_json(folder / "summary.json", summary)
    card = folder / "README.md"
    table = re.compile(r"^[^\n]* (?:fixed|test) starts .*?(?=`metrics.csv`)", re.DOTALL | re.MULTILINE)
    card.write_text(table.sub(lambda _: f"{words}:\n\n{write_results(summary)}\n", card.read_text()))
    write_sums(folder)


if __name__ == "__main__":
    revision = read_revision()  # None if fishrl/ has been changed, as it will be by the first card
    if revision is None:
        raise SystemExit("commit what has been changed in fishrl/ first")
    for chosen in sys.argv[1:] or list_policies():
        renew(chosen, revision)
