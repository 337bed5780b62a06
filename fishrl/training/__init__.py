"""Train a policy for any task, evaluate it, load it again.

Example::

    from fishrl.envs import Flows, Predation
    from fishrl.training import DiscreteSAC, LearningSettings, RunSettings, evaluate, train

    summary = train(
        task=Predation(body_length=40, reynolds=2000),
        algorithm=DiscreteSAC(target_entropy_weight=0.1),
        learning=LearningSettings(seed=1, flows=Flows(num_envs=8)),
        run=RunSettings(total_frames=2000, folder="runs", name="first"),
    )
    print(summary["success_rate"], summary["random_success_rate"])
    print(evaluate("runs/first", episodes=64))

``resume("runs/first", total_frames=4000)`` continues a finished or interrupted run exactly.
"""

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
