"""Programs that run a policy, by default in the task of the policy's run."""

from typing import Any

from fishrl.programs.configuration import Node
from fishrl.training.checkpoint import Checkpoint
from fishrl.training.policies import is_learned
from fishrl.training.run_folder import read_summary
from fishrl.zoo import find_folder

#: Settings that choose the episode of ``fishrl view``.
_TYPICAL = ("episodes", "shown_flows")


def read_task(given: Node) -> Node:
    """Return task and recognition of the learned ``policy`` that is given.

    The task is left out where the command line, ``given``, names a task or a preset.
    """
    policy = given.get("policy")
    if policy is None or not is_learned(policy):
        return {}
    trained = Checkpoint.find(policy).config
    found: dict[str, Any] = {}
    if "recognition.path" not in given:
        found["recognition"] = trained.get("recognition")
    if not {"task", "preset"} & set(given):
        found |= {name: trained[name] for name in ("task", "preset") if name in trained}
    return found


#: Arguments of ``program`` for those that run a policy.
POLICY: dict[str, Any] = {
    "without": ("callbacks",),
    "groups": {"task": "predation", "preset": None},
    "stored": read_task,
}


def read_typical(given: Node) -> Node:
    """Return what ``read_task`` does, and the settings that show a typical episode, if known."""
    found, others = read_task(given), {"task", "preset", "recognition", "seed", *_TYPICAL}
    if found and not others & {name.partition(".")[0] for name in given}:
        view = read_result(given["policy"]).get("view", {})
        found |= {name: view[name] for name in _TYPICAL if name in view}
    return found


def read_result(policy: str) -> dict[str, Any]:
    """Return the result of the final evaluation of a learned policy; empty where none is stored."""
    return read_summary(find_folder(policy) / "summary.json") if is_learned(policy) else {}
