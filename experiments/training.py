"""The training loop, the only one."""

from __future__ import annotations

import logging
import math
import random
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from torchrl.checkpoint import GlobalRNGState
from torchrl.envs import EnvBase

from experiments.checkpointing import BrainOf, load_checkpoint, save_checkpoint
from experiments.collector import ResumableCollector
from experiments.config import to_plain
from experiments.evaluation import (
    Evaluation,
    Evaluator,
    Policy,
    copy_state,
    fixed_starts,
    has_succeeded,
)
from experiments.learner import LOSS_METRICS, Learner, one_thread
from experiments.live import LiveView
from experiments.policies import list_baselines, make_policy
from experiments.progress import Progress
from experiments.recognition import Recognition
from experiments.run_folder import RunFolder
from experiments.settings import TrainConfig

logger = logging.getLogger(__name__)

MakeEnv = Callable[..., EnvBase]

#: Every column of metrics.csv: ``train/`` over the last episodes or of the last gradient step,
#: ``eval/`` of the greedy policy from fixed starts, ``time/`` of this machine. The seed fixes all
#: but the last kind.
METRICS = (
    "frames",
    "train/episodes",
    "train/return",
    "train/success_rate",
    "train/episode_length",
    "train/diverged",
    "train/updates",
    *(f"train/{name}" for name in LOSS_METRICS),
    "eval/success_rate",
    "eval/mean_return",
    "eval/mean_length_T",
    "eval/mean_time_to_success_T",
    "eval/episodes",
    "eval/diverged",
    "time/wall_seconds",
    "time/frames_per_second",
    "time/mlups",
)
#: Episodes that the training return and rate of success are averaged over.
WINDOW = 32
#: Training draws its starts from generators far from those of the fixed starts.
TRAIN_SEED, SELECTION_SEED, FINAL_SEED = 1000, 1, 0


@dataclass
class Counters:
    """What a run has done so far."""

    frames: int = 0
    updates: int = 0
    episodes: int = 0
    diverged: int = 0
    wall_seconds: float = 0.0
    collect_seconds: float = 0.0
    best: list[float] = field(default_factory=list)
    recent: deque[list[float]] = field(default_factory=lambda: deque(maxlen=WINDOW))

    def state_dict(self) -> dict[str, Any]:
        """Return plain numbers and lists."""
        return {**vars(self), "recent": list(self.recent)}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore what ``state_dict`` returned."""
        for name, value in state.items():
            setattr(self, name, value)
        self.recent = deque(state["recent"], maxlen=WINDOW)

    def count(self, transitions: TensorDictBase, *, success: str) -> None:
        """Count the episodes that end in transitions ``[N]``; diverged ones are no episodes.

        Args:
            transitions: ``[N]``.
            success: see ``has_succeeded``.
        """
        after = transitions["next"]
        has_ended = (after["done"] & ~after["diverged"]).reshape(-1)
        ended = after[has_ended]
        columns = (ended["episode_reward"], has_succeeded(ended, success), ended["step_count"])
        for numbers in zip(*(column.reshape(-1).tolist() for column in columns), strict=True):
            self.episodes += 1
            self.recent.append([float(number) for number in numbers])


class Training:
    """One run: collect, learn, evaluate, save, until the frames are used up.

    Args:
        config: its settings.
        recognition: the task, and who tells the fish its flow.
        make_env: makes the env of a task.
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
        folder: RunFolder,
        metrics_logger: Any,
        progress: Progress,
        began: float,
    ) -> None:
        self.config, self.task = config, recognition.task
        task = self.task
        self.folder, self.metrics_logger, self.progress = folder, metrics_logger, progress
        self.brain = BrainOf.task_of(task, num_told=recognition.num_told)
        self.counters, self.is_told = Counters(), recognition.num_told > 0
        self._began = began
        self.decision_T = task.interval_T
        flow = task.flow_config()
        self.nodes_per_frame = flow.width * flow.height * task.n_substeps
        random.seed(config.seed)
        np.random.seed(config.seed % 2**32)  # noqa: NPY002 - whoever uses the global one
        torch.manual_seed(config.seed)
        self.learner = Learner(
            num_inputs=self.brain.num_inputs, num_actions=self.brain.num_actions, config=config
        )
        progress.rename("compilation" if config.compile else "set-up")
        self.collector = ResumableCollector(
            recognition.equip(make_env)(
                task=task,
                num_envs=config.num_envs,
                seed=TRAIN_SEED + config.seed,
                device=config.device,
                compile=config.compile,
                frames_per_action=task.checks_per_action,  # for the recording at the end
            ),
            self.learner.actor,
            frames_per_batch=config.num_envs,
            total_frames=-1,
            init_random_frames=config.warmup_frames,
        )
        self.live: LiveView | None = None
        if config.live:
            self.live = LiveView(self.collector.env.base_env, config, is_told=self.is_told)
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
        """Train, evaluate against the hand-written fish, and return the summary."""
        config, counters = self.config, self.counters
        plain = to_plain(config)
        self.metrics_logger.open(
            self.folder.path, columns=METRICS, config=plain, step=counters.frames
        )
        if counters.frames == 0:
            self._save(self.folder.last, plain)
        self._learn(plain)
        return self._compare()

    def close(self) -> None:
        """End the flows, the log and the live view."""
        if self.live is not None:
            self.live.close()
        self.metrics_logger.close()
        self.collector.shutdown()

    def _learn(self, plain: dict[str, Any]) -> None:
        """Run the loop: collect, remember, learn; now and then evaluate, log and save."""
        config, counters = self.config, self.counters
        self.progress.start(self._phase(), total=config.total_frames, done=counters.frames)
        batches = iter(self.collector)
        while counters.frames < config.total_frames:
            before = counters.frames
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
            metrics = self._train_metrics(losses)
            is_over = counters.frames >= config.total_frames
            if is_over or _has_crossed(config.eval_frames, before, counters.frames):
                metrics |= self._select(plain)
            counters.wall_seconds = self.wall_seconds()
            metrics |= self._time_metrics(batch.numel(), seconds)
            if "eval/success_rate" in metrics or _has_crossed(
                config.log_frames, before, counters.frames
            ):
                self.metrics_logger.log(metrics)
            if is_over or _has_crossed(config.checkpoint_frames, before, counters.frames):
                self._save(self.folder.last, plain)
            self.progress.rename(self._phase())
            self.progress.advance(
                batch.numel(),
                frames_per_s=metrics["time/frames_per_second"],
                MLUPS=metrics["time/mlups"],
                **{
                    "return": metrics["train/return"],
                    self.task.success: metrics["train/success_rate"],
                },
            )

    def _phase(self) -> str:
        return "warm-up" if self.counters.frames < self.config.warmup_frames else "training"

    def _update(self) -> Any:
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

    def _train_metrics(self, losses: Any) -> dict[str, float]:
        counters = self.counters
        recent = np.array(counters.recent) if counters.recent else np.full((1, 3), np.nan)
        metrics = {
            "frames": counters.frames,
            "train/episodes": counters.episodes,
            "train/return": float(recent[:, 0].mean()),
            "train/success_rate": float(recent[:, 1].mean()),
            "train/episode_length": float(recent[:, 2].mean()),
            "train/diverged": counters.diverged,
            "train/updates": counters.updates,
        }
        if losses is not None:
            metrics |= {f"train/{name}": float(losses[name]) for name in LOSS_METRICS}
        return metrics

    def _time_metrics(self, num_frames: int, seconds: float) -> dict[str, float]:
        return {
            "time/wall_seconds": self.counters.wall_seconds,
            "time/frames_per_second": num_frames / seconds,
            "time/mlups": self._mlups(num_frames, seconds),
        }

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
        if score >= self.counters.best:
            self.counters.best = score
            self._save(self.folder.best, plain)
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
        state = copy_state(self.collector.state_dict())
        starts = fixed_starts(self.task, num_starts, seed=seed)
        live = self.live
        on_step = None if live is None else live.settle
        result = self.evaluator.run(policy, starts=starts, on_episodes=on_episodes, on_step=on_step)
        self.collector.load_state_dict(state)
        if live is not None:
            live.restart()
        return result

    def _save(self, path: Any, plain: dict[str, Any]) -> None:
        save_checkpoint(
            path,
            self.components(),
            brain=self.brain,
            preset=self.config.preset,
            frames=self.counters.frames,
            config=plain,
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
        fish: dict[str, Policy] = {"learned": self.learner.actor}
        baselines = list_baselines(self.task) if config.baselines is None else config.baselines
        for name in baselines:
            fish[name] = make_policy(name, task=self.task, seed=FINAL_SEED)
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
            "baselines": list(baselines),
            "preset": config.preset,
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
