"""The training loop, the only one."""

from __future__ import annotations

import logging
import math
import random
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from torchrl.checkpoint import GlobalRNGState

from experiments.config import to_plain
from experiments.settings import TrainConfig
from fishrl.training.algorithms import build_algorithm
from fishrl.training.checkpoint import (
    BrainOf,
    CheckpointNotWritten,
    load_checkpoint,
    save_checkpoint,
)
from fishrl.training.collector import MakeEnv, make_collector
from fishrl.training.evaluation import Evaluation, Evaluator, Policy, fixed_starts
from fishrl.training.interruption import Interrupted, Interruption, spare_children
from fishrl.training.learner import one_thread
from fishrl.training.metrics import Counters, list_metrics, measure_memory_mb
from fishrl.training.progress import Progress
from fishrl.training.recognition import Recognition
from fishrl.training.run_folder import RunFolder
from fishrl.viewer import LiveView

logger = logging.getLogger(__name__)

#: Training draws its starts from generators far from those of the fixed starts.
TRAIN_SEED, SELECTION_SEED, FINAL_SEED = 1000, 1, 0


class Training:
    """One run: collect, learn, evaluate, save, until the frames are used up.

    Args:
        config: its settings.
        recognition: the task, and who tells the fish its flow.
        make_env: makes the env of a task.
        baselines: hand-written fish to compare with, see ``make_baselines``.
        folder: where everything is written.
        metrics_logger: where numbers go.
        progress: the bar.
        began: ``time.perf_counter()`` when the program started.
    """

    def __init__(
        self,
        *,
        config: TrainConfig,
        recognition: Recognition,
        make_env: MakeEnv,
        baselines: Mapping[str, Policy],
        folder: RunFolder,
        metrics_logger: Any,
        progress: Progress,
        began: float,
    ) -> None:
        self._lock = folder.hold()
        self.config, self.task, self.baselines = config, recognition.task, baselines
        task = self.task
        self.folder, self.metrics_logger, self.progress = folder, metrics_logger, progress
        self.brain = BrainOf.task_of(task, num_told=recognition.num_told)
        self.counters, self.interruption = Counters(), Interruption()
        self.is_told = recognition.is_told
        self._began = began
        self.decision_T = task.interval_T
        flow = task.flow_config()
        self.nodes_per_frame = flow.width * flow.height * task.n_substeps
        random.seed(config.seed)
        np.random.seed(config.seed % 2**32)  # noqa: NPY002 - whoever uses the global one
        torch.manual_seed(config.seed)
        self.algorithm = build_algorithm({"algorithm": config.algorithm})
        self.learner = self.algorithm.make_learner(self.brain, config)
        progress.rename("compilation" if config.compile else "set-up")
        with spare_children():  # a checkpoint needs what the flows' processes hold
            self.collector = make_collector(
                config, recognition, make_env, self.learner, seed=TRAIN_SEED + config.seed
            )
        self.live: LiveView | None = None
        if config.live:
            self.live = LiveView(self.collector.env, config)
        self.evaluator = Evaluator(self.collector.env, decision_T=self.decision_T)

    def components(self) -> dict[str, Any]:
        """Name everything that the next frame depends on."""
        return {
            **self.learner.components(),
            "collector": self.collector,
            "rng": GlobalRNGState(),
            "counters": self.counters,
        }

    def resume(self) -> None:
        """Go on from the last checkpoint in the folder.

        Raises:
            ValueError: if it is missing, corrupt, or of another task.
        """
        load_checkpoint(
            self.folder.path,
            self.components(),
            brain=self.brain,
            device=self.config.device,
            which="last",
        )
        self._began -= self.counters.wall_seconds
        logger.info("going on from frame %d of %s", self.counters.frames, self.folder.path)

    def wall_seconds(self) -> float:
        """Seconds since the program started, those of the runs before a resume included."""
        return time.perf_counter() - self._began

    def run(self) -> dict[str, Any]:
        """Train, evaluate against the hand-written fish, and return the summary.

        Raises:
            Interrupted: if the program was told to end; what was learned is saved.
            CheckpointNotWritten: if the first or the last checkpoint cannot be written.
        """
        counters, plain = self.counters, to_plain(self.config)
        self.metrics_logger.open(
            self.folder.path,
            columns=list_metrics(self.learner.reports),
            config=plain,
            step=counters.frames,
        )
        if counters.frames == 0:
            self._save(self.folder.last, plain)
        try:
            self._learn(plain)
        except Interrupted:
            self._save(self.folder.last, plain)
            raise
        return self._compare()

    def close(self) -> None:
        """End the flows, the log and the live view."""
        if self.live is not None:
            self.live.close()
        self.metrics_logger.close()
        self.collector.shutdown()
        self._lock.close()

    def _learn(self, plain: dict[str, Any]) -> None:
        """Run the loop: collect, remember, learn; now and then evaluate, log and save."""
        config, counters = self.config, self.counters
        self.progress.start(self._phase(), total=config.total_frames, done=counters.frames)
        batches = iter(self.collector)
        while counters.pending or counters.frames < config.total_frames:
            if not counters.pending:
                self.interruption.check()
                counters.pending = self._collect_and_update(batches)
            metrics = self._conclude(plain)
            self.progress.rename(self._phase())
            self.progress.advance(
                config.num_envs,
                frames_per_s=metrics["time/frames_per_second"],
                MLUPS=metrics["time/mlups"],
                **{
                    "return": metrics["train/return"],
                    self.task.success: metrics["train/success_rate"],
                },
            )

    def _collect_and_update(self, batches: Any) -> dict[str, float]:
        """Take a decision in every flow, learn from it, and return what was measured."""
        counters = self.counters
        start = time.perf_counter()
        batch = next(batches).reshape(-1)
        seconds = time.perf_counter() - start
        if self.live is not None:
            self.live.settle(batch)
        counters.collect_seconds += seconds
        counters.frames += batch.numel()
        counters.diverged += self.learner.remember(batch)
        counters.count(batch, success=self.task.success)
        losses = self._update()
        return {
            **counters.metrics(),
            **({} if losses is None else self._read(losses)),
            "time/frames_per_second": batch.numel() / seconds,
            "time/mlups": self._mlups(batch.numel(), seconds),
        }

    def _conclude(self, plain: dict[str, Any]) -> dict[str, float]:
        """Complete the row of the newest frames: evaluate, log and save if it is time to."""
        config, counters, metrics = self.config, self.counters, self.counters.pending
        before = counters.frames - config.num_envs
        is_over = counters.frames >= config.total_frames
        if is_over or _has_crossed(config.eval_frames, before, counters.frames):
            metrics = metrics | self._select(plain)
        counters.wall_seconds = metrics["time/wall_seconds"] = self.wall_seconds()
        if "eval/success_rate" in metrics or _has_crossed(
            config.log_frames, before, counters.frames
        ):
            self.metrics_logger.log(metrics | {"time/memory_mb": measure_memory_mb()})
        counters.pending = {}
        if is_over:
            self._save(self.folder.last, plain)
        elif _has_crossed(config.checkpoint_frames, before, counters.frames):
            self._try_to_save(self.folder.last, plain)
        return metrics

    def _phase(self) -> str:
        return "warm-up" if self.counters.frames < self.config.warmup_frames else "training"

    def _read(self, losses: TensorDictBase) -> dict[str, float]:
        return {f"train/{name}": float(losses[name]) for name in self.learner.reports}

    def _update(self) -> TensorDictBase | None:
        """Take the gradient steps that are due since the warm-up, and return the last losses."""
        config, counters = self.config, self.counters
        learned_from = counters.frames - config.warmup_frames
        due = math.floor(config.updates_per_frame * learned_from) - counters.updates
        losses = None
        if len(self.learner.buffer) > 0:
            with one_thread():
                for _ in range(due):
                    losses = self.learner.update()
                    counters.updates += 1
        return losses

    def _mlups(self, num_frames: int, seconds: float) -> float:
        """Million lattice node updates per second of the env, sensing and policy included."""
        return self.nodes_per_frame * num_frames / max(seconds, 1e-9) / 1e6

    def _select(self, plain: dict[str, Any]) -> dict[str, float]:
        """Evaluate the greedy policy and keep it if it is the best so far."""
        self.progress.rename("evaluation")
        result = self._evaluate(
            self.learner.actor, num_starts=self.config.eval_episodes, seed=SELECTION_SEED
        ).metrics()
        score = [result["success_rate"], result["mean_return"]]
        best = self.counters.best
        if score >= best:
            self.counters.best = score
            if not self._try_to_save(self.folder.best, plain):
                self.counters.best = best
        return {f"eval/{name}": value for name, value in result.items()}

    def _evaluate(
        self,
        policy: Policy,
        *,
        num_starts: int,
        seed: int,
        on_episodes: Callable[[int], None] | None = None,
    ) -> Evaluation:
        """Evaluate in the flows that training uses, and leave them as they were."""
        starts = fixed_starts(self.task, num_starts, seed=seed)
        live = self.live
        on_step = None if live is None else live.settle
        try:
            with self.collector.lend_env():
                return self.evaluator.run(
                    self.watch(policy), starts=starts, on_episodes=on_episodes, on_step=on_step
                )
        finally:
            if live is not None:
                live.restart()

    def watch(self, policy: Policy) -> Policy:
        """Return a policy that stops where the program was told to end."""

        def act(state: TensorDictBase) -> TensorDictBase:
            self.interruption.check()
            return policy(state)

        return act

    def _try_to_save(self, path: Path, plain: dict[str, Any]) -> bool:
        """Save if that is possible; a run does not end because its disk is full for a while."""
        try:
            self._save(path, plain)
        except CheckpointNotWritten as error:
            logger.error("%s; going on without", error)
            return False
        return True

    def _save(self, path: Path, plain: dict[str, Any]) -> None:
        save_checkpoint(
            path,
            self.components(),
            brain=self.brain,
            preset=self.config.preset,
            frames=self.counters.frames,
            config=plain,
            keep=self.config.keep_checkpoints if path == self.folder.last else 1,
        )

    def _compare(self) -> dict[str, Any]:
        """Evaluate the best learned fish and the hand-written ones from the same starts."""
        config, counters = self.config, self.counters
        metadata = load_checkpoint(
            self.folder.path,
            {"actor": self.learner.actor},
            brain=self.brain,
            device=config.device,
        )
        summary: dict[str, Any] = {}
        fish: dict[str, Policy] = {"learned": self.learner.actor, **self.baselines}
        self.progress.start("evaluation", total=config.final_episodes * len(fish))
        for name, policy in fish.items():
            self.progress.rename(f"evaluation: {name}")
            result = self._evaluate(
                policy,
                num_starts=config.final_episodes,
                seed=FINAL_SEED,
                on_episodes=self.progress.advance,
            ).metrics()
            prefix = "" if name == "learned" else f"{name}_"
            summary |= {f"{prefix}{key}": value for key, value in result.items()}
        summary |= {
            "task": self.brain.task,
            "success": self.task.success,
            "baselines": list(self.baselines),
            "preset": config.preset,
            "algorithm": config.algorithm,
            "seed": config.seed,
            "frames": counters.frames,
            "best_checkpoint_frames": metadata["frames"],
            "updates": counters.updates,
            "train_episodes": counters.episodes,
            "train_diverged": counters.diverged,
            "wall_seconds": self.wall_seconds(),
            "mlups": self._mlups(counters.frames, counters.collect_seconds),
        }
        return summary


def make_flow_env() -> MakeEnv:
    """Return the maker of the real env."""
    from fishrl.envs.flow_env import make_env

    return make_env


def _has_crossed(interval: int, before: int, after: int) -> bool:
    return after // interval > before // interval
