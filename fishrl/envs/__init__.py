"""Environments: one habitat for all tasks, and the tasks."""

from fishrl.envs.flow_env import FlowEnv, make_env
from fishrl.envs.task import AbstractTask, Command
from fishrl.envs.tasks import KarmanGait, Predation

__all__ = ["AbstractTask", "Command", "FlowEnv", "KarmanGait", "Predation", "make_env"]
