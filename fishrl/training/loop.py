"""The training loop: collect, store, update; evaluate, log and save at intervals."""

from __future__ import annotations

import logging
import math
import os
import random
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from torchrl.checkpoint import GlobalRNGState

from fishrl.envs.agents import split_fish
from fishrl.envs.episodes import Episodes, Policy, name_counted
from fishrl.envs.transforms import equip
from fishrl.training.baselines import make_baselines
from fishrl.training.checkpoint import CheckpointNotWritten, load_checkpoint, save_checkpoint
from fishrl.training.classifier import Recognition
from fishrl.training.collector import make_collector
from fishrl.training.description import describe
from fishrl.training.evaluation import evaluate_from, fixed_starts
from fishrl.training.interruption import Interrupted, Interruption, ignore_signals_in_children
from fishrl.training.learner import one_thread
from fishrl.training.metrics import Counters, list_metrics, measure_memory_mb
from fishrl.training.observer import Hooks
from fishrl.training.plan import Plan
from fishrl.training.policy_spec import PolicySpec
from fishrl.training.run_folder import RunFolder, write_json

logger = logging.getLogger(__name__)

#: Training draws its starts from generators far from those of the fixed starts, which choose the
#: best checkpoint and end a run.
TRAIN_SEED, SELECTION_SEED, FINAL_SEED = 1000, 1, 0


class RNGState(GlobalRNGState):
    """The state of all random number generators.

    Those of GPUs that are not there are left out: a run goes on with other GPUs or on a CPU, though
    not bit for bit.
    """

    def load_state_dict(self, state_dict: Mapping[str, Any]) -> None:
        """Restore the generators of this machine."""
        gpus = state_dict.get("torch_cuda", [])[: torch.cuda.device_count()]
        others = {name: value for name, value in state_dict.items() if name != "torch_cuda"}
        super().load_state_dict(others | ({"torch_cuda": gpus} if gpus else {}))


class Training:
    """One run: collect, update, evaluate and save until ``total_frames`` is reached.

    ``recognition`` is the source of flow labels, see ``fishrl.envs.make_env``; ``hooks`` see
    ``Hooks``.
    """

    def __init__(
        self,
        plan: Plan,
        *,
        recognition: Recognition,
        folder: RunFolder,
        hooks: Hooks,
    ) -> None:
        self._lock = folder.hold()
        self.plan, self.folder, self.config, self.hooks = plan, folder, plan.to_config(), hooks
        self.observer, self.progress, self._began = hooks.observer, hooks.progress, hooks.began
        self.task, _ = equip(plan.task, recognition)
        self.spec = PolicySpec.for_task(self.task, has_labels=recognition is not None)
        self.baselines = make_baselines(plan.run.baselines, task=self.task, seed=FINAL_SEED)
        self.counters, self.interruption = Counters(), Interruption()
        flow, learning = self.task.flow_config(), plan.learning
        self.nodes_per_frame = flow.width * flow.height * self.task.n_substeps
        random.seed(learning.seed)
        np.random.seed(learning.seed)  # noqa: NPY002 - for whatever uses the global generator
        torch.manual_seed(learning.seed)
        device = plan.run.policy_device
        self.learner = plan.algorithm.make_learner(self.spec, learning, device=device)
        self.progress.rename("compilation" if plan.run.compile else "set-up")
        with ignore_signals_in_children():  # a checkpoint needs the flows in these processes
            self.collector = make_collector(
                plan,
                self.task,
                self.learner,
                make_env=hooks.make_env,
                recognition=recognition,
                seed=TRAIN_SEED + learning.seed,
            )
        self.observer.begin(self.collector.env)

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
        device = self.plan.run.policy_device
        load_checkpoint(
            self.folder.path, self.components(), spec=self.spec, device=device, which="last"
        )
        self._began -= self.counters.wall_seconds
        logger.info("continuing from frame %d of %s", self.counters.frames, self.folder.path)

    def wall_seconds(self) -> float:
        """Seconds since the program started, plus those before a resume."""
        return time.perf_counter() - self._began

    def run(self) -> dict[str, Any]:
        """Train, evaluate the best policy and the baselines, and return the summary.

        Raises:
            Interrupted: after SIGINT or SIGTERM; everything is saved.
            ChildProcessError: if a process of the flows dies; see ``runs.complete``.
            CheckpointNotWritten: if the first or the last checkpoint cannot be written.
        """
        counters = self.counters
        columns = list_metrics(self.learner.reports, name_counted(self.collector.env))
        self.plan.logger.open(
            self.folder.path, columns=columns, config=self.config, step=counters.frames
        )
        if counters.frames == 0:
            self._save(self.folder.last)
        try:
            self._learn()
        except Interrupted:
            self._save(self.folder.last)
            raise
        summary = self._summarize()
        try:
            self.observer.finish(self, summary)
        except Interrupted:  # unfinished, so that a resume does it
            raise
        except Exception:
            write_json(self.folder.summary, summary)
            raise
        summary["wall_seconds"] = self.wall_seconds()
        write_json(self.folder.summary, summary)
        return summary

    def close(self) -> None:
        """End the flows, the log and the observer."""
        self.observer.close()
        self.plan.logger.close()
        self.collector.shutdown()
        self._lock.close()

    def _learn(self) -> None:
        """Run the loop until ``total_frames`` is reached.

        Each round collects a frame of every flow and learns, then evaluates, logs and saves if due.
        An interrupt in between leaves ``counters.pending``, which a resumed run completes first.
        """
        counters, run = self.counters, self.plan.run
        self.progress.start(self._phase(), total=run.total_frames, done=counters.frames)
        batches = iter(self.collector)
        while counters.pending or counters.frames < run.total_frames:
            if not counters.pending:
                self.interruption.check()
                counters.pending = self._collect_and_update(batches)
            metrics = self._conclude()
            self.progress.rename(self._phase())
            shown = {
                "frames per s": metrics["time/frames_per_second"],
                "MLUPS": metrics["time/mlups"],
                "return": metrics["train/return"],
                self.task.success or "survived": metrics["train/success_rate"],
            }
            self.progress.advance(self.plan.learning.num_envs, **shown)
        if counters.updates == 0:
            logger.warning(
                "no gradient step in %d frames: learning begins after warmup_frames = %d, that of "
                "PPO after a whole rollout; raise total_frames",
                counters.frames,
                self.plan.learning.warmup_frames,
            )

    def _collect_and_update(self, batches: Iterator[TensorDictBase]) -> dict[str, float]:
        """Step every flow once, take the gradient steps due, and return the metrics."""
        counters = self.counters
        start = time.perf_counter()
        batch = next(batches).reshape(-1)
        seconds = time.perf_counter() - start
        self.observer.settle(batch)
        counters.collect_seconds += seconds
        counters.frames += batch.numel()
        counters.diverged += self.learner.store(split_fish(batch)) // self.task.num_fish
        counters.count(batch, success=self.task.success)
        self._update()
        return {
            **counters.metrics(),
            **{f"train/{name}": value for name, value in counters.losses.items()},
            "time/frames_per_second": batch.numel() / seconds,
            "time/mlups": self.mlups(batch.numel(), seconds),
        }

    def _update(self) -> None:
        """Take the gradient steps that are due."""
        learning, counters = self.plan.learning, self.counters
        learned_from = counters.frames - learning.warmup_frames
        per_frame = learning.updates_per_frame * self.task.num_fish
        due = math.floor(per_frame * learned_from) - counters.updates
        if due <= 0 or not self.learner.is_ready:
            return
        with one_thread():
            for _ in range(due):
                losses = self.learner.update()
                counters.updates += 1
        counters.losses = {name: float(losses[name]) for name in self.learner.reports}

    def _conclude(self) -> dict[str, float]:
        """Complete the metrics of the newest frames: evaluate, log and save if due."""
        run, counters, metrics = self.plan.run, self.counters, self.counters.pending
        is_over = counters.frames >= run.total_frames
        is_evaluated = is_over or self._has_crossed(run.eval_frames)
        if is_evaluated:
            metrics = metrics | self._select()
        counters.wall_seconds = metrics["time/wall_seconds"] = self.wall_seconds()
        if is_evaluated or self._has_crossed(run.log_frames):
            self.plan.logger.log(metrics | {"time/memory_mb": measure_memory_mb()})
            counters.losses = {}
        counters.pending = {}
        if is_over or self._has_crossed(run.checkpoint_frames):
            self._save(self.folder.last, is_needed=is_over)
        return metrics

    def _has_crossed(self, interval: int) -> bool:
        """Tell whether the newest frames passed a multiple of ``interval``."""
        after = self.counters.frames
        return after // interval > (after - self.plan.learning.num_envs) // interval

    def _phase(self) -> str:
        is_warm = self.counters.frames >= self.plan.learning.warmup_frames
        return "training" if is_warm else "warm-up"

    def mlups(self, num_frames: int, seconds: float) -> float:
        """Million lattice node updates per second of the env, sensing and policy included."""
        return self.nodes_per_frame * num_frames / max(seconds, 1e-9) / 1e6

    def _select(self) -> dict[str, float]:
        """Evaluate the greedy policy and keep it if it is the best so far."""
        self.progress.rename("evaluation")
        num_starts = self.plan.run.eval_episodes
        result = self.evaluate(self.learner.actor, num_starts=num_starts, seed=SELECTION_SEED)
        metrics, best = result.metrics(), self.counters.best
        score = [metrics["success_rate"], metrics["mean_return"]]
        if score >= best:
            self.counters.best = score
            if not self._save(self.folder.best, is_needed=False):
                self.counters.best = best
        return {f"eval/{name}": value for name, value in metrics.items()}

    def _summarize(self) -> dict[str, Any]:
        """Evaluate the best policy and the baselines; return what ``summary.json`` holds.

        Metrics of the learned policy have no prefix, those of a baseline ``<name>_``.
        """
        run, counters, actor = self.plan.run, self.counters, self.learner.actor
        best = load_checkpoint(
            self.folder.path, {"actor": actor}, spec=self.spec, device=run.policy_device
        )
        summary: dict[str, Any] = {}
        policies: dict[str, Policy] = {"": actor, **self.baselines}
        self.progress.start("evaluation", total=run.final_episodes * len(policies))
        for name, policy in policies.items():
            self.progress.rename(f"evaluation: {name or 'learned'}")
            result = self.evaluate(
                policy,
                num_starts=run.final_episodes,
                seed=FINAL_SEED,
                on_episodes=self.progress.advance,
            )
            prefix = f"{name}_" if name else ""
            summary |= {f"{prefix}{key}": value for key, value in result.metrics().items()}
        return summary | {
            "task": self.spec.task,
            "success": self.task.success or "survived",
            "baselines": list(self.baselines),
            "preset": self.plan.preset,
            "algorithm": describe(self.plan.algorithm),
            "seed": self.plan.learning.seed,
            "frames": counters.frames,
            "best_checkpoint_frames": best["frames"],
            "updates": counters.updates,
            "train_episodes": counters.episodes,
            "train_diverged": counters.diverged,
            "wall_seconds": self.wall_seconds(),
            "mlups": self.mlups(counters.frames, counters.collect_seconds),
        }

    def evaluate(
        self,
        policy: Policy,
        *,
        num_starts: int,
        seed: int,
        on_episodes: Callable[[int], None] | None = None,
    ) -> Episodes:
        """Evaluate from fixed starts in the flows of training, and leave these as they were."""
        starts = fixed_starts(self.task, num_starts, seed=seed)
        try:
            with self.collector.lend_env():
                return evaluate_from(
                    self.collector.env,
                    self.make_interruptible(policy),
                    starts,
                    on_episodes=on_episodes,
                    on_step=self.observer.settle,
                )
        finally:
            self.observer.restart()

    def make_interruptible(self, policy: Policy) -> Policy:
        """Return a policy that raises ``Interrupted`` after SIGINT or SIGTERM.

        It acts on the device of the learner, wherever the flows are.
        """

        def act(state: TensorDictBase) -> TensorDictBase:
            self.interruption.check()
            return state.update(policy(state.to(self.plan.run.policy_device)))

        return act

    def _save(self, path: Path, *, is_needed: bool = True) -> bool:
        """Save, if not needed then if possible: a run outlives a disk that is full for a while."""
        if path == self.folder.last:  # the rows that it counts outlive a power failure, too
            with suppress(OSError), self.folder.metrics.open("rb") as rows:
                os.fsync(rows.fileno())
        try:
            save_checkpoint(
                path,
                self.components(),
                spec=self.spec,
                frames=self.counters.frames,
                config=self.config,
                keep=self.plan.run.keep_checkpoints if path == self.folder.last else 1,
            )
        except CheckpointNotWritten as error:
            if is_needed:
                raise
            logger.error("%s; continuing without", error)
            return False
        return True
