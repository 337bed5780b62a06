"""The task of the policy that a program runs: by default that of the policy's run."""

from typing import Any

from fishrl.programs.configuration import Node
from fishrl.training.checkpoint import Checkpoint
from fishrl.training.policies import is_learned


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
