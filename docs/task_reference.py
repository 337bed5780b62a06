"""Generate the page of what each task observes, what its actions are, and its reward.

Numbers and units are those of the task's senses, formulas those under ``Terms:`` in the docstrings
of its ``reward``.
"""

import inspect
import re
from pathlib import Path
from typing import get_args

from fishrl.envs import AbstractTask, Follower, KarmanGait, Predation, PredationPair
from fishrl.envs.control import Bend
from fishrl.envs.senses import SenseName

HEAD = """# Observations, actions and rewards

After this page you know each number that a policy observes, each action and each term of the
reward, as the code defines them; the reward is the sum of its terms, which are also reported as
`reward/<term>`. Units: L body length, T period, ρ density, U speed of the fastest stream. Settings
are those of the [configuration reference](configuration.md).

"""
BENDING = Predation(control=Bend(bend_bl=0.2), control_interval_T=0.25, checks_per_action=10)
TASKS: dict[str, AbstractTask] = {
    "Predation": Predation(),
    "Predation by a fish that bends": BENDING,
    "PredationPair": PredationPair(),
    "KarmanGait": KarmanGait(),
    "KarmanGait with all senses": KarmanGait(observes=get_args(SenseName)),
    "Follower": Follower(),
}


def write_task_reference(path: Path) -> None:
    """Write the page if it has changed."""
    text = make_task_reference()
    if not path.is_file() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def make_task_reference() -> str:
    """Return the page as Markdown."""
    return HEAD + "\n\n".join(f"## {name}\n\n{show(task)}" for name, task in TASKS.items()) + "\n"


def show(task: AbstractTask) -> str:
    """Return the tables of one task."""
    numbers = [(sense.name, number) for sense in task.senses for number in sense.numbers]
    observed = [f"| {i} | {sense} | {number} |" for i, (sense, number) in enumerate(numbers)]
    head = "index" if task.action_bounds is None else "component"
    actions = [f"| {i} | {name} |" for i, name in enumerate(task.action_names)]
    terms = [f"| `{name}` | {formula} |" for name, formula in read_terms(type(task)).items()]
    return "\n".join(
        [
            "| index | sense | number |\n|---|---|---|",
            *observed,
            f"\n| {head} | action |\n|---|---|",
            *actions,
            "\n| term of the reward | value |\n|---|---|",
            *terms,
        ]
    )


def read_terms(kind: type[AbstractTask]) -> dict[str, str]:
    """Return the formulas under ``Terms:`` by the names of the terms, those of bases first."""
    texts: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        doc, name = inspect.cleandoc(vars(base).get("reward", base).__doc__ or ""), ""
        _, _, section = doc.partition("\nTerms:\n")
        for line in section.splitlines():
            if begins := re.match(r" {4}(\w+): (.*)", line):
                name, texts[begins.group(1)] = begins.groups()
            elif name and line.strip():
                texts[name] += " " + line.strip()
    return {name: text.replace("|", "\\|").replace("``", "`") for name, text in texts.items()}
