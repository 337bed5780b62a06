"""The training loop: collect, store, update; evaluate, log and save at intervals."""

from __future__ import annotations

import logging
import math
import random
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase

from fishrl.envs.agents import split_fish
from fishrl.envs.episodes import name_counted
from fishrl.settings import describe
from fishrl.training.callback import Callback, join
from fishrl.training.collector import make_collector
from fishrl.training.evaluation import SELECTION_SEED, TRAIN_SEED, Evaluator
from fishrl.training.interruption import Interrupted, Interruption, ignore_signals_in_children
from fishrl.training.learner import one_thread
from fishrl.training.metrics import Counters, list_metrics, measure_memory_mb
from fishrl.training.resolve import ResolvedRun
from fishrl.training.run_folder import RunFolder, write_json
from fishrl.training.saving import RNGState, Saver

logger = logging.getLogger(__name__)


class Training:
    """One run: collect, update, evaluate and save until ``total_frames`` is reached.

    Args:
        resolved: the run.
        folder: where it is written, by no other process.
        callbacks: see ``Callback``.
        interruption: remembers the signal that ends the run.
    """

    def __init__(
        self,
        resolved: ResolvedRun,
        *,
        folder: RunFolder,
        callbacks: Iterable[Callback] = (),
        interruption: Interruption | None = None,
    ) -> None:
        self._began, self._lock = time.perf_counter(), folder.hold()
        self.resolved, self.folder, self.plan = resolved, folder, resolved.plan
        self.task, self.callbacks = resolved.task, join(callbacks)
        self.counters, self.interruption = Counters(), interruption or Interruption()
        seed = self.plan.learning.seed
        random.seed(seed)
        np.random.seed(seed)  # noqa: NPY002 - for libraries that use the global generator
        torch.manual_seed(seed)
        self.learner = self.plan.algorithm.make_learner(
            resolved.spec, self.plan.learning, device=self.plan.run.policy_device
        )
        self.callbacks.on_phase("compilation" if self.plan.run.compile else "set-up")
        with ignore_signals_in_children():  # a checkpoint needs the flows in these processes
            self.collector = make_collector(resolved, self.learner, seed=TRAIN_SEED + seed)
        self._saver = Saver(resolved, folder, self.components)
        self.evaluator = Evaluator(
            resolved, self.collector, callbacks=self.callbacks, interruption=self.interruption
        )
        self.callbacks.on_begin(self.collector.env)

    def components(self) -> dict[str, Any]:
        """Return by name everything that the next frame depends on, for a checkpoint."""
        return {
            **self.learner.components(),
            "collector": self.collector,
            "rng": RNGState(),
            "counters": self.counters,
        }

    def restore(self) -> None:
        """Continue from the last checkpoint in the folder; see ``load_checkpoint``."""
        self._saver.load_last()
        self._began -= self.counters.wall_seconds
        logger.info("continuing from frame %d of %s", self.counters.frames, self.folder.path)

    def run(self) -> dict[str, Any]:
        """Train, evaluate the best policy and the baselines, and return the summary.

        Raises:
            Interrupted: after SIGINT or SIGTERM; everything is saved.
            ChildProcessError: if a process of the flows dies; see ``runs.complete``.
            CheckpointNotWritten: if the first or the last checkpoint cannot be written.
        """
        columns = list_metrics(self.learner.reports, name_counted(self.collector.env))
        self.plan.logger.open(
            self.folder.path,
            columns=columns,
            config=self.plan.to_config(),
            step=self.counters.frames,
        )
        if self.counters.frames == 0:
            self._save(self.folder.last)
        try:
            self._learn()
        except Interrupted:
            self._save(self.folder.last)
            raise
        summary = self._summarize()
        try:
            self.callbacks.on_end(
                summary,
                folder=self.folder.path,
                env=self.collector.env,
                policy=self.evaluator.make_interruptible(self.learner.actor),
            )
        except Interrupted:  # unfinished, so that a resume repeats the end
            raise
        except Exception:
            write_json(self.folder.summary, summary)
            raise
        summary["wall_seconds"] = self._wall_seconds()
        write_json(self.folder.summary, summary)
        return summary

    def _learn(self) -> None:
        """Collect, store and update until ``total_frames``; evaluate, log and save when due."""
        counters, settings = self.counters, self.plan.run
        self.callbacks.on_phase(self._phase(), total=settings.total_frames, done=counters.frames)
        batches = iter(self.collector)
        while counters.pending or counters.frames < settings.total_frames:
            if not counters.pending:  # else this run was interrupted before it concluded the round
                self.interruption.check()
                batch, seconds = self._collect(batches)
                counters.diverged += self.learner.store(split_fish(batch)) // self.task.num_fish
                self._update()
                counters.pending = self._measure(batch.numel(), seconds)
            self._conclude()
        if counters.updates == 0:
            logger.warning(
                "no gradient step in %d frames: learning begins after warmup_frames = %d, with PPO "
                "after the first whole rollout; raise total_frames",
                counters.frames,
                self.plan.learning.warmup_frames,
            )

    def _collect(self, batches: Iterator[TensorDictBase]) -> tuple[TensorDictBase, float]:
        """Step every flow once; return the transitions ``[num_envs]`` and the seconds taken."""
        start = time.perf_counter()
        batch = next(batches).reshape(-1)
        seconds = time.perf_counter() - start
        self.callbacks.on_step(batch)
        self.counters.collect_seconds += seconds
        self.counters.frames += batch.numel()
        self.counters.count(batch, success=self.task.success)
        return batch, seconds

    def _update(self) -> None:
        """Take the gradient steps that are due."""
        learning, counters = self.plan.learning, self.counters
        per_frame = learning.updates_per_frame * self.task.num_fish
        due = math.floor(per_frame * (counters.frames - learning.warmup_frames)) - counters.updates
        if due <= 0 or not self.learner.is_ready:
            return
        with one_thread():
            for _ in range(due):
                losses = self.learner.update()
                counters.updates += 1
        counters.losses = {name: float(losses[name]) for name in self.learner.reports}

    def _measure(self, num_frames: int, seconds: float) -> dict[str, float]:
        """Return the metrics of a round without those of an evaluation."""
        return {
            **self.counters.metrics(),
            **{f"train/{name}": value for name, value in self.counters.losses.items()},
            "time/frames_per_second": num_frames / seconds,
            "time/mlups": self._mlups(num_frames, seconds),
        }

    def _conclude(self) -> None:
        """Evaluate, log and save if due after the round whose metrics are pending."""
        settings, counters, metrics = self.plan.run, self.counters, self.counters.pending
        is_over = counters.frames >= settings.total_frames
        is_evaluated = is_over or self._has_crossed(settings.eval_frames)
        if is_evaluated:
            metrics = metrics | self._select()
        counters.wall_seconds = metrics["time/wall_seconds"] = self._wall_seconds()
        if is_evaluated or self._has_crossed(settings.log_frames):
            self.plan.logger.log(metrics | {"time/memory_mb": measure_memory_mb()})
            counters.losses = {}
        counters.pending = {}
        if is_over or self._has_crossed(settings.checkpoint_frames):
            self._save(self.folder.last, is_needed=is_over)
        self.callbacks.on_phase(self._phase())
        shown = {
            "frames per s": metrics["time/frames_per_second"],
            "MLUPS": metrics["time/mlups"],
            "return": metrics["train/return"],
            self.resolved.success: metrics["train/success_rate"],
        }
        self.callbacks.on_progress(self.plan.learning.num_envs, shown)

    def _select(self) -> dict[str, float]:
        """Evaluate the greedy policy and keep it if it is the best so far."""
        self.callbacks.on_phase("evaluation")
        num_starts = self.plan.run.eval_episodes
        result = self.evaluator.evaluate(
            self.learner.actor, num_starts=num_starts, seed=SELECTION_SEED
        )
        metrics, best = result.metrics(), self.counters.best
        score = [metrics["success_rate"], metrics["mean_return"]]
        if score >= best:
            self.counters.best = score
            if not self._save(self.folder.best, is_needed=False):
                self.counters.best = best
        return {f"eval/{name}": value for name, value in metrics.items()}

    def _summarize(self) -> dict[str, Any]:
        """Evaluate the best policy and the baselines; return the content of ``summary.json``."""
        counters = self.counters
        best_frames = self._saver.load_best(self.learner.actor)
        return {
            **self.evaluator.compare(self.learner.actor),
            "task": self.resolved.spec.task,
            "success": self.resolved.success,
            "baselines": list(self.resolved.baselines),
            "preset": self.plan.preset,
            "algorithm": describe(self.plan.algorithm),
            "seed": self.plan.learning.seed,
            "frames": counters.frames,
            "best_checkpoint_frames": best_frames,
            "updates": counters.updates,
            "train_episodes": counters.episodes,
            "train_diverged": counters.diverged,
            "wall_seconds": self._wall_seconds(),
            "mlups": self._mlups(counters.frames, counters.collect_seconds),
        }

    def _save(self, path: Path, *, is_needed: bool = True) -> bool:
        return self._saver.save(path, frames=self.counters.frames, is_needed=is_needed)

    def close(self) -> None:
        """End the flows, the log and the callbacks."""
        self.callbacks.on_close()
        self.plan.logger.close()
        self.collector.shutdown()
        self._lock.close()

    def _wall_seconds(self) -> float:
        """Return the seconds since the run was set up, plus those before a resume."""
        return time.perf_counter() - self._began

    def _mlups(self, num_frames: int, seconds: float) -> float:
        """Million lattice node updates per second of the env, sensing and policy included."""
        flow = self.task.flow_config()
        num_nodes = flow.width * flow.height * self.task.n_substeps
        return num_nodes * num_frames / max(seconds, 1e-9) / 1e6

    def _has_crossed(self, interval: int) -> bool:
        """Tell whether the newest frames passed a multiple of ``interval``."""
        after = self.counters.frames
        return after // interval > (after - self.plan.learning.num_envs) // interval

    def _phase(self) -> str:
        is_warm = self.counters.frames >= self.plan.learning.warmup_frames
        return "training" if is_warm else "warm-up"
