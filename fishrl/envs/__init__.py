"""The environment and its tasks."""

from fishrl.envs.command import Command
from fishrl.envs.episodes import run_episodes
from fishrl.envs.extensions import HasFlowLabels, HasHistory, HasScene
from fishrl.envs.flow_env import FlowEnv
from fishrl.envs.flows import Flows
from fishrl.envs.making import make_env, make_task
from fishrl.envs.one_hot import OneHotAction
from fishrl.envs.recognition import Oracle, Recognition
from fishrl.envs.sense import Sense
from fishrl.envs.task import AbstractTask
from fishrl.envs.tasks import Follower, KarmanGait, Predation, PredationPair
from fishrl.envs.transforms import PredictedFlowLabel, TrueFlowLabel

__all__ = [
    "AbstractTask",
    "Command",
    "FlowEnv",
    "Flows",
    "Follower",
    "HasFlowLabels",
    "HasHistory",
    "HasScene",
    "KarmanGait",
    "OneHotAction",
    "Oracle",
    "Predation",
    "PredationPair",
    "PredictedFlowLabel",
    "Recognition",
    "Sense",
    "TrueFlowLabel",
    "make_env",
    "make_task",
    "run_episodes",
]
