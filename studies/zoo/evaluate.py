"""Evaluate policies of the zoo again, from the starts of their cards, and renew the cards' results.

    python studies/zoo/evaluate.py                 # all of them
    python studies/zoo/evaluate.py gait_bend ...

A card then says with which commit. Baselines of the cards are evaluated again, too.
"""

import json
import re
import sys
from dataclasses import replace

from fishrl.envs import Flows
from fishrl.programs.export_policy import read_revision
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
    path, card = folder / "summary.json", folder / "README.md"
    summary, task = json.loads(path.read_text()), plan.task
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
    write_json(path, summary)
    table = re.compile(r"^[^\n]* from fixed starts .*?(?=`metrics.csv`)", re.DOTALL | re.MULTILINE)
    when = f"for 40 T (`task.time_limit={LONGER[name]}`) " if name in LONGER else ""
    words = (
        f"Evaluation {when}from fixed starts that were not used to choose it, at commit "
        f"{commit[:8]}:\n\n{write_results(summary)}\n"
    )
    card.write_text(table.sub(lambda _: words, card.read_text()))
    write_sums(folder)


if __name__ == "__main__":
    revision = read_revision()  # None if fishrl/ has been changed, as it will be by the first card
    if revision is None:
        raise SystemExit("commit what has been changed in fishrl/ first")
    for chosen in sys.argv[1:] or list_policies():
        renew(chosen, revision)
