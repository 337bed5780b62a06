"""The summary of a run: its best policy and the baselines, from the same fixed starts."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from fishrl.envs.episodes import Policy
from fishrl.training.checkpoint import load_checkpoint
from fishrl.training.description import describe

if TYPE_CHECKING:
    from fishrl.training.loop import Training

#: Seed of the starts of every run's last evaluation.
FINAL_SEED = 0


def summarize(training: Training) -> dict[str, Any]:
    """Load the best policy, evaluate it and the baselines, and return what ``summary.json`` holds.

    Metrics of the learned policy have no prefix, those of a baseline ``<name>_``.
    """
    plan, counters, progress = training.plan, training.counters, training.progress
    metadata = load_checkpoint(
        training.folder.path,
        {"actor": training.learner.actor},
        spec=training.spec,
        device=plan.run.device,
    )
    summary: dict[str, Any] = {}
    policies: dict[str, Policy] = {"learned": training.learner.actor, **training.baselines}
    progress.start("evaluation", total=plan.run.final_episodes * len(policies))
    for name, policy in policies.items():
        progress.rename(f"evaluation: {name}")
        result = training.evaluate(
            policy,
            num_starts=plan.run.final_episodes,
            seed=FINAL_SEED,
            on_episodes=progress.advance,
        )
        prefix = "" if name == "learned" else f"{name}_"
        summary |= {f"{prefix}{key}": value for key, value in result.metrics().items()}
    return summary | {
        "task": training.spec.task,
        "success": training.task.success,
        "baselines": list(training.baselines),
        "preset": plan.preset,
        "algorithm": describe(plan.algorithm),
        "seed": plan.learning.seed,
        "frames": counters.frames,
        "best_checkpoint_frames": metadata["frames"],
        "updates": counters.updates,
        "train_episodes": counters.episodes,
        "train_diverged": counters.diverged,
        "wall_seconds": training.wall_seconds(),
        "mlups": training.mlups(counters.frames, counters.collect_seconds),
    }
