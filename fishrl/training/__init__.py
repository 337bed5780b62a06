"""Train a policy for any task, evaluate it, load it again; see the README for an example."""

from fishrl.training.algorithms import DQN, DRQN, Algorithm, DiscreteSAC
from fishrl.training.baselines import Baseline, find_baselines
from fishrl.training.interruption import Interrupted
from fishrl.training.observer import Hooks, Observer
from fishrl.training.plan import Plan
from fishrl.training.policies import evaluate, load_plan, load_policy
from fishrl.training.runs import begin, complete, find_summary, make_folder, reopen, resume, train
from fishrl.training.settings import LearningSettings, RunSettings

__all__ = [
    "DQN",
    "DRQN",
    "Algorithm",
    "Baseline",
    "DiscreteSAC",
    "Hooks",
    "Interrupted",
    "LearningSettings",
    "Observer",
    "Plan",
    "RunSettings",
    "begin",
    "complete",
    "evaluate",
    "find_baselines",
    "find_summary",
    "load_plan",
    "load_policy",
    "make_folder",
    "reopen",
    "resume",
    "train",
]
