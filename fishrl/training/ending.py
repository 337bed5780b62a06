"""The end of a training: final evaluation, comparison with baselines, summary."""

from typing import TYPE_CHECKING, Any

from fishrl.envs.episodes import Policy
from fishrl.settings import describe
from fishrl.training.baselines import make_baseline
from fishrl.training.evaluation import FINAL_SEED
from fishrl.training.interruption import Interrupted
from fishrl.training.run_folder import write_json

if TYPE_CHECKING:
    from fishrl.training.loop import Training


def finish(training: "Training") -> dict[str, Any]:
    """Evaluate the best policy and the baselines of a training; write and return the summary."""
    plan, counters, actor = training.plan, training.counters, training.learner.actor
    best, folder = training.load({"actor": actor}, which="best"), training.folder
    summary = compare(training) | {
        "task": training.resolved.spec.task,
        "success": training.resolved.success,
        "baselines": list(training.resolved.baselines),
        "preset": plan.preset,
        "algorithm": describe(plan.algorithm),
        "seed": plan.learning.seed,
        "frames": counters.frames,
        "best_checkpoint_frames": best["frames"],
        "updates": counters.updates,
        "train_episodes": counters.episodes,
        "train_diverged": counters.diverged,
        "wall_seconds": training.wall_seconds(),
        "mlups": training.resolved.compute_mlups(counters.frames, counters.collect_seconds),
    }
    env, policy = training.collector.env, training.make_interruptible(actor)
    try:
        training.callbacks.on_end(summary, folder=folder.path, env=env, policy=policy)
    except Interrupted:  # unfinished, so that a resume repeats the end
        raise
    except Exception:
        write_json(folder.summary, summary)
        raise
    summary["wall_seconds"] = training.wall_seconds()
    write_json(folder.summary, summary)
    return summary


def compare(training: "Training") -> dict[str, Any]:
    """Return the final metrics of the learned policy, and ``<name>_...`` of each baseline."""
    names, num_starts = training.resolved.baselines, training.plan.run.final_episodes
    metrics: dict[str, Any] = {}
    training.callbacks.on_phase("evaluation", total=num_starts * (1 + len(names)))
    for name in ("", *names):
        training.callbacks.on_phase(f"evaluation: {name or 'learned'}")
        policy: Policy = training.learner.actor
        if name:
            policy = make_baseline(name, task=training.task, seed=FINAL_SEED)
        result = training.evaluate(policy, num_starts, seed=FINAL_SEED).metrics()
        metrics |= {f"{name}_{key}" if name else key: value for key, value in result.items()}
    return metrics
