"""The training loop: collect, store, update; evaluate, log and save at intervals."""

import logging
import math
import os
import random
import time
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase

from fishrl.envs.agents import split_fish
from fishrl.envs.episodes import Episodes, Policy, name_counted, name_terms, run_episodes
from fishrl.settings import describe
from fishrl.torch_state import in_own_state, one_thread
from fishrl.training.baselines import make_baseline
from fishrl.training.callback import Callback, join
from fishrl.training.checkpoint import Checkpoint, CheckpointNotWritten, save_checkpoint
from fishrl.training.collector import RNGState, make_collector
from fishrl.training.evaluation import FINAL_SEED, SELECTION_SEED, TRAIN_SEED, fixed_starts
from fishrl.training.interruption import Interrupted, Interruption, ignore_signals_in_children
from fishrl.training.logger import CsvLogger
from fishrl.training.metrics import Counters, compute_mlups, list_metrics, measure_memory_mb
from fishrl.training.opening import Opened
from fishrl.training.run_folder import write_json, write_yaml

logger = logging.getLogger(__name__)


class Training:
    """One run: collect, update, evaluate and save until ``total_frames`` is reached.

    Args:
        opened: the run; ValueError if it does not fit this machine, or another process writes it.
        callbacks: see ``Callback``.
        interruption: remembers the signal that ends the run.
    """

    @partial(in_own_state, is_learning=True)
    def __init__(
        self,
        opened: Opened,
        *,
        callbacks: Iterable[Callback] = (),
        interruption: Interruption | None = None,
    ) -> None:
        self._began = time.perf_counter()
        opened.check()
        before, self.opened = opened, opened.enter()
        opened = self.opened
        self.folder, self.plan, self.task = opened.folder, opened.plan, opened.task
        self.logger = self.plan.logger or CsvLogger()
        self.counters, self.interruption = Counters(), interruption or Interruption()
        self.callbacks, self._lock = join(callbacks), self.folder.hold()
        with ExitStack() as self._held:  # released if the rest fails
            self._held.enter_context(self._lock)
            before.check_current(self.folder)
            if opened.checkpoint is None:
                self._write_settings()
            logger.info("run folder: %s", self.folder.path)
            with self.folder.noting_failure():
                self._set_up()
                if opened.checkpoint is not None:
                    self._restore(opened.checkpoint)
                    self._write_settings()
            if self.plan.total_frames < self._first_step():
                logger.warning(
                    "no gradient step of the policy in this run: total_frames = %d, the first is "
                    "at %g; raise total_frames",
                    self.plan.total_frames,
                    self._first_step(),
                )
            self._held = self._held.pop_all()

    def _first_step(self) -> float:
        """Return the env frames before the first gradient step of the policy."""
        per_frame = self.plan.updates_per_frame * self.task.num_fish
        due = math.ceil(1.0 / per_frame) if per_frame else math.inf
        first = max(self.learner.first_frames, self.plan.warmup_frames + due)
        return first + self.plan.critic_frames

    def _write_settings(self) -> None:
        """Write the settings, which a result of other settings would not fit."""
        if self.opened.result is None:
            self.folder.summary.unlink(missing_ok=True)
        else:
            self.folder.ending.touch()
        write_yaml(self.folder.config, self.opened.stored | self.plan.to_config())

    def _set_up(self) -> None:
        """Make the learner and the flows."""
        self._held.callback(RNGState().load_state_dict, RNGState().state_dict())  # the caller's
        seed = self.plan.seed
        random.seed(seed)
        np.random.seed(seed)  # noqa: NPY002 - for libraries that use the global generator
        torch.manual_seed(seed)
        self.learner = self.plan.algorithm.make_learner(
            self.opened.spec,
            self.plan,
            device=self.plan.policy_device,
            initial=self.opened.initial,
        )
        self.callbacks.on_phase("compilation" if self.plan.flows.compile else "set-up")
        with ignore_signals_in_children():  # a checkpoint needs the flows in these processes
            self.collector = make_collector(self.opened, self.learner, seed=TRAIN_SEED + seed)
        self._held.callback(self.collector.shutdown)

    @partial(in_own_state, is_learning=True)
    def run(self) -> dict[str, Any]:
        """Train, evaluate the best policy and the baselines, and return the summary.

        Raises:
            Interrupted: after a signal of ``SIGNALS``; everything is saved.
            ChildProcessError: if a process of the flows dies; see ``runs.complete``.
            CheckpointNotWritten: if the first or the last checkpoint cannot be written.
        """
        env, frames = self.collector.env, self.counters.frames
        self._held.callback(self.logger.close)
        self._held.callback(self.callbacks.on_close)
        if frames == 0:
            self._save(self.folder.last)
            self._try_baselines()
        self.callbacks.on_begin(env)
        columns = list_metrics(self.learner.reports, name_counted(env), name_terms(env))
        config = self.plan.to_config()
        self.logger.open(self.folder.path, columns=columns, config=config, step=frames)
        try:
            self._learn()
        except Interrupted:
            self._save(self.folder.last)
            raise
        return self._finish()

    def _try_baselines(self) -> None:
        """Let each baseline decide once, so that one that fails does so before the training."""
        starts = fixed_starts(self.task, 1, seed=FINAL_SEED)
        with self.collector.lend_env() as env:
            for name in self.opened.baselines:
                try:
                    policy = make_baseline(name, task=self.task, seed=FINAL_SEED)
                    run_episodes(env, self._make_interruptible(policy), starts, max_decisions=1)
                except Exception as error:
                    error.add_note(f"in baseline {name!r}: mend it, or leave it out of baselines")
                    raise

    def _learn(self) -> None:
        """Collect, store and update until ``total_frames``; evaluate, log and save when due."""
        counters, total = self.counters, self.plan.total_frames
        begun = self.plan.flows.num_envs if counters.pending else 0  # counted when it is concluded
        self.callbacks.on_phase(self._phase(), total=total, done=counters.frames - begun)
        batches = iter(self.collector)
        while counters.pending or counters.frames < total:
            if not counters.pending:  # else the run was interrupted before this round's evaluation
                self.interruption.check()
                batch, seconds = self._collect(batches)
                counters.diverged += self.learner.store(split_fish(batch)) // self.task.num_fish
                self._update()
                counters.pending = {
                    **counters.metrics(),
                    **{f"train/{name}": value for name, value in counters.losses.items()},
                    "time/frames_per_second": batch.numel() / seconds,
                    "time/mlups": compute_mlups(self.task, batch.numel(), seconds),
                }
            self._conclude(counters.pending)

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
        plan, counters = self.plan, self.counters
        per_frame = plan.updates_per_frame * self.task.num_fish
        due = per_frame * (counters.frames - plan.warmup_frames) - counters.updates
        due = math.floor(due + 1e-6)  # of PPO, a whole number but for round-off
        if due <= 0 or not self.learner.is_ready:
            return
        if plan.critic_frames:
            begins = self.learner.first_frames + plan.critic_frames
            self.learner.rest_actor(counters.frames < begins)
        with one_thread():
            for _ in range(due):
                losses = self.learner.update()
                counters.updates += 1
        counters.losses = {name: float(losses[name]) for name in self.learner.reports}
        broken = [name for name, x in counters.losses.items() if "loss_" in name and x != x]
        if broken:
            raise ValueError(
                f"{', '.join(broken)}: is NaN after {counters.updates} gradient steps, so the "
                "policy is lost; lower learning_rate"
            )

    def _conclude(self, metrics: dict[str, float]) -> None:
        """Evaluate, log and save if due after a round with these metrics."""
        plan, counters = self.plan, self.counters
        is_over = counters.frames >= plan.total_frames
        is_evaluated = is_over or self._has_crossed(plan.eval_frames)
        if is_evaluated:
            metrics = metrics | self._select()
        counters.wall_seconds = metrics["time/wall_seconds"] = self._wall_seconds()
        if is_evaluated or self._has_crossed(plan.log_frames):
            self.logger.log(metrics | {"time/memory_mb": measure_memory_mb()})
            counters.losses = {}
        counters.pending = {}
        if is_over or self._has_crossed(plan.checkpoint_frames):
            self._save(self.folder.last, is_needed=is_over)
        shown = {
            "frames per s": metrics["time/frames_per_second"],
            "MLUPS": metrics["time/mlups"],
            "return": metrics["train/return"],
            self.opened.success: metrics["train/success_rate"],
        }
        self.callbacks.on_phase(self._phase())
        self.callbacks.on_progress(self.plan.flows.num_envs, shown)

    def _select(self) -> dict[str, float]:
        """Evaluate the greedy policy and keep it if it is the best so far."""
        self.callbacks.on_phase("evaluation")
        actor, num, before = self.learner.actor, self.plan.eval_episodes, self.counters.best
        metrics = self._evaluate(actor, num, seed=SELECTION_SEED, is_counted=False).metrics()
        score = [metrics["success_rate"], metrics["mean_return"]]
        if score >= before:
            self.counters.best = score
            if not self._save(self.folder.best, is_needed=False):
                self.counters.best = before
        return {f"eval/{name}": value for name, value in metrics.items()}

    def _finish(self) -> dict[str, Any]:
        """Write the result, unless it is there already, let callbacks end, and return it."""
        folder, actor = self.folder, self.learner.actor
        best = Checkpoint.find(folder.path)
        self._load(best, {"actor": actor})
        if (result := self.opened.result) is None:
            result = self._compare() | self._describe(best)
            folder.ending.touch()
            write_json(folder.summary, result)
            self.opened = replace(self.opened, result=result)
        self.callbacks.on_end(
            result,
            folder=folder.path,
            env=self.collector.env,
            policy=self._make_interruptible(actor),
        )
        folder.ending.unlink(missing_ok=True)
        return result

    def _describe(self, best: Checkpoint) -> dict[str, Any]:
        """Return the entries of the summary that are no results of the final evaluation."""
        counters = self.counters
        return {
            "task": type(self.task).__name__,
            "success": self.opened.success,
            "baselines": list(self.opened.baselines),
            "preset": self.plan.preset,
            "algorithm": describe(self.plan.algorithm),
            "seed": self.plan.seed,
            "frames": counters.frames,
            "best_checkpoint_frames": best.frames,
            "updates": counters.updates,
            "train_episodes": counters.episodes,
            "train_diverged": counters.diverged,
            "wall_seconds": self._wall_seconds(),
            "mlups": compute_mlups(self.task, counters.frames, counters.collect_seconds),
        }

    def _compare(self) -> dict[str, Any]:
        """Return the final metrics of the learned policy, and ``<name>_...`` of each baseline."""
        names, num = self.opened.baselines, self.plan.final_episodes
        metrics: dict[str, Any] = {}
        self.callbacks.on_phase("evaluation", total=num * (1 + len(names)))
        for name in ("", *names):
            self.callbacks.on_phase(f"evaluation: {name or 'learned'}")
            policy: Policy = self.learner.actor
            if name:
                policy = make_baseline(name, task=self.task, seed=FINAL_SEED)
            episodes = self._evaluate(policy, num, seed=FINAL_SEED)
            prefix = f"{name}_" if name else ""
            metrics |= {f"{prefix}{key}": value for key, value in episodes.metrics().items()}
            if not name:  # settings of fishrl view that show a typical episode
                metrics["view"] = {"episodes": num, "shown_flows": [episodes.find_typical()]}
        return metrics

    def _evaluate(
        self, policy: Policy, num: int, *, seed: int, is_counted: bool = True
    ) -> Episodes:
        """Run one episode from each of ``num`` fixed starts.

        A learned policy acts greedily; callbacks count the episodes if ``is_counted``. The flows
        continue as they were.
        """
        try:
            with self.collector.lend_env() as env:
                return run_episodes(
                    env,
                    self._make_interruptible(policy),
                    fixed_starts(self.task, num, seed=seed),
                    on_step=lambda start_of, step: self.callbacks.on_step(step),
                    on_episodes=self.callbacks.on_progress if is_counted else None,
                )
        finally:
            self.callbacks.on_new_episodes()

    def _make_interruptible(self, policy: Policy) -> Policy:
        """Return a policy that acts on the learner's device, or raises ``Interrupted``."""

        def act(state: TensorDictBase) -> TensorDictBase:
            self.interruption.check()
            return state.update(policy(state.to(self.plan.policy_device)))

        return act

    def _components(self) -> dict[str, Any]:
        """Return by name everything that the next frame depends on, for a checkpoint."""
        others = {"collector": self.collector, "rng": RNGState(), "counters": self.counters}
        return self.learner.components() | others

    def _restore(self, checkpoint: Checkpoint) -> None:
        """Continue from a checkpoint."""
        self._load(checkpoint, self._components())
        self._began -= self.counters.wall_seconds
        logger.info("continuing from frame %d of %s", self.counters.frames, self.folder.path)

    def _load(self, checkpoint: Checkpoint, components: dict[str, Any]) -> None:
        checkpoint.load(components, spec=self.opened.spec, device=self.plan.policy_device)

    def _save(self, path: Path, *, is_needed: bool = True) -> bool:
        """Save a checkpoint; a failure is only logged unless ``is_needed``, as on a full disk."""
        is_last = path == self.folder.last
        if is_last:  # so that a power failure cannot lose rows older than the checkpoint
            with suppress(OSError), self.folder.metrics.open("rb") as rows:
                os.fsync(rows.fileno())
        try:
            save_checkpoint(
                path,
                self._components(),
                spec=self.opened.spec,
                frames=self.counters.frames,
                config=self.plan.to_config(),
                keep=self.plan.keep_checkpoints if is_last else 1,
            )
        except CheckpointNotWritten as error:
            if is_needed:
                raise
            logger.error("%s; continuing without", error)
            return False
        return True

    def close(self) -> None:
        """End the flows, the log and the callbacks; random generators are as before the run."""
        self._held.close()

    def _wall_seconds(self) -> float:
        """Return the seconds since the run was set up, plus those before a resume."""
        return time.perf_counter() - self._began

    def _has_crossed(self, interval: int) -> bool:
        """Tell whether the newest frames passed a multiple of ``interval``."""
        after = self.counters.frames
        return after // interval > (after - self.plan.flows.num_envs) // interval

    def _phase(self) -> str:
        is_warm = self.counters.frames >= self.plan.warmup_frames
        return "training" if is_warm else "warm-up"
