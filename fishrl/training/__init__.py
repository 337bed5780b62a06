"""Train a policy for any task (``train``, ``resume``), evaluate it, load it again."""

from fishrl.training.algorithms import Algorithm
from fishrl.training.algorithms.discrete_sac import DiscreteSAC
from fishrl.training.baselines import baseline, find_baselines
from fishrl.training.callback import Callback
from fishrl.training.interruption import Interrupted
from fishrl.training.loop import Training
from fishrl.training.opening import Opened, open_run
from fishrl.training.plan import Plan
from fishrl.training.policies import evaluate, load_plan, load_policy
from fishrl.training.progress import Progress
from fishrl.training.recognition import Classifier
from fishrl.training.runs import complete, resume, train
from fishrl.training.settings import LearningSettings, RunSettings

__all__ = [
    "Algorithm",
    "Callback",
    "Classifier",
    "DiscreteSAC",
    "Interrupted",
    "LearningSettings",
    "Opened",
    "Plan",
    "Progress",
    "RunSettings",
    "Training",
    "baseline",
    "complete",
    "evaluate",
    "find_baselines",
    "load_plan",
    "load_policy",
    "open_run",
    "resume",
    "train",
]
