"""Programs that run a policy, by default in the task of the policy's run."""

from collections.abc import Callable
from typing import Any

from fishrl.programs.configuration import Node
from fishrl.programs.program import Program, program
from fishrl.training.checkpoint import Checkpoint
from fishrl.training.policies import evaluate, is_learned


def policy_program(
    *parts: type, without: tuple[str, ...] = ("callbacks",), positional: str | None = None
) -> Callable[[Callable[..., None]], Program]:
    """Make a program that takes the arguments of ``evaluate``; see ``program``."""
    return program(
        evaluate,
        *parts,
        without=without,
        groups={"task": "predation", "preset": None},
        stored=read_task,
        positional=positional,
    )


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
