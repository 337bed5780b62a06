"""The settings of the programs, each one argument of a dataclass, checked when it is made."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from dataclasses import dataclass, field
from importlib.util import find_spec
from typing import Any

from omegaconf import MISSING

from fishrl.viewer import ViewerSettings

#: How a run learns that does not say.
DEFAULT_ALGORITHM = {"_target_": "fishrl.training.algorithms.discrete_sac.DiscreteSAC"}


class ConfigError(ValueError):
    """A setting that does not exist or cannot be, in words for the one who typed it."""


@dataclass(kw_only=True)
class TrainConfig(ViewerSettings):
    """Settings of a training run, beside those of ``ViewerSettings``.

    Args:
        task: ``_target_`` and arguments of the task.
        logger: ``_target_`` and arguments of the logger.
        algorithm: ``_target_`` and arguments of the algorithm (``fishrl.training.algorithms``).
        preset: name of the preset, kept in the checkpoints.
        seed: of networks, starts and actions; one seed gives one learning curve.
        device: cpu or cuda.
        compile: compile the flow solver.
        folder: where run folders lie.
        name: of the run folder; by default made from task, preset and seed.
        resume: run folder to go on with, from its last checkpoint.
        recognition: who tells the fish which flow it is in: ``oracle``, the file of a lateral-line
            machine, or nobody.
        num_envs: flows that advance together.
        ray_collectors: processes of a Ray cluster that share the flows; by default all advance in
            this one.
        total_frames: env frames (decisions of one fish) to train for.
        warmup_frames: frames with random legal actions before learning starts.
        updates_per_frame: gradient steps per env frame.
        batch_size: transitions per gradient step.
        buffer_size: transitions kept.
        gamma: discount per decision.
        learning_rate: of everything that is learned.
        tau: step of the target networks.
        hidden: widths of the hidden layers of every network.
        log_frames: frames between rows of the metrics.
        checkpoint_frames: frames between checkpoints.
        keep_checkpoints: how many of them stay, the newest.
        eval_frames: frames between evaluations of the greedy policy.
        eval_episodes: fixed starts of these evaluations, which choose the best checkpoint.
        final_episodes: fixed starts of the evaluation at the end, other ones than those.
        baselines: hand-written fish that go through the same evaluation at the end; by
            default those of ``policies.list_baselines``.
        picture_episodes: of these starts, how many are recorded and drawn; 0 for no pictures.
    """

    task: Any = MISSING
    logger: Any = MISSING
    algorithm: Any = field(default_factory=DEFAULT_ALGORITHM.copy)
    preset: str | None = None
    seed: int = 0
    device: str = "cpu"
    compile: bool = True
    folder: str = "runs"
    name: str | None = None
    resume: str | None = None
    recognition: str | None = None
    num_envs: int = 16
    ray_collectors: int = 0
    total_frames: int = 2800
    warmup_frames: int = 320
    updates_per_frame: float = 4.0
    batch_size: int = 64
    buffer_size: int = 20_000
    gamma: float = 0.99
    learning_rate: float = 5e-4
    tau: float = 0.01
    hidden: list[int] = field(default_factory=lambda: [256, 256])
    log_frames: int = 64
    checkpoint_frames: int = 350
    keep_checkpoints: int = 2
    eval_frames: int = 700
    eval_episodes: int = 16
    final_episodes: int = 32
    baselines: list[str] | None = None
    picture_episodes: int = 6

    def __post_init__(self) -> None:
        """Refuse what cannot run."""
        super().__post_init__()
        for name in ("num_envs", "total_frames", "batch_size", "buffer_size", "log_frames"):
            _at_least(name, getattr(self, name), 1)
        for name in ("checkpoint_frames", "keep_checkpoints", "eval_frames"):
            _at_least(name, getattr(self, name), 1)
        for name in ("eval_episodes", "final_episodes"):
            _at_least(name, getattr(self, name), 1)
        for name in ("warmup_frames", "updates_per_frame", "seed", "picture_episodes"):
            _at_least(name, getattr(self, name), 0)
        if self.batch_size > self.buffer_size:
            raise ConfigError(
                f"batch_size = {self.batch_size}: must be at most buffer_size = {self.buffer_size}"
            )
        self._check_collectors()
        for name in ("gamma", "tau"):
            _at_least(name, getattr(self, name), 0)
            if getattr(self, name) > 1:
                raise ConfigError(f"{name} = {getattr(self, name)}: must be at most 1")
        if self.learning_rate <= 0:
            raise ConfigError(f"learning_rate = {self.learning_rate}: must be greater than 0")

    def _check_collectors(self) -> None:
        _at_least("ray_collectors", self.ray_collectors, 0)
        if not self.ray_collectors:
            return
        if self.num_envs % self.ray_collectors:
            raise ConfigError(
                f"num_envs = {self.num_envs}: must be a multiple of ray_collectors = "
                f"{self.ray_collectors}"
            )
        if self.live or self.device != "cpu":
            raise ConfigError(
                f"ray_collectors = {self.ray_collectors}: the flows advance elsewhere and on CPUs; "
                "take live=false and device=cpu"
            )


@dataclass(kw_only=True)
class EvaluateConfig(ViewerSettings):
    """Settings of an evaluation, beside those of ``ViewerSettings``.

    Args:
        task: ``_target_`` and arguments of the task; a checkpoint brings its own unless ``task``
            or ``preset`` is given, and ``task.<argument>`` changes it.
        preset: name of the preset.
        checkpoint: run folder or checkpoint of the fish to evaluate.
        policy: hand-written fish to evaluate instead; ``policies.NAMES`` lists those of each task.
        recognition: as for training; a checkpoint brings its own.
        episodes: fixed starts, one episode each.
        num_envs: flows that advance together.
        seed: of the starts and of random actions; 0 gives those of every run's last evaluation, 1
            those that chose its checkpoint.
        device: cpu or cuda.
        compile: compile the flow solver.
        save: file for the result and all these settings as JSON, or nothing.
    """

    task: Any = MISSING
    preset: str | None = None
    checkpoint: str | None = None
    policy: str | None = None
    recognition: str | None = None
    episodes: int = 32
    num_envs: int = 16
    seed: int = 0
    device: str = "cpu"
    compile: bool = True
    save: str | None = None

    def __post_init__(self) -> None:
        """Refuse what cannot run."""
        super().__post_init__()
        for name in ("num_envs", "episodes"):
            _at_least(name, getattr(self, name), 1)
        if (self.checkpoint is None) == (self.policy is None):
            raise ConfigError(
                "give one of checkpoint=<run folder> and policy=<hand-written fish>, such as random"
            )


@dataclass(kw_only=True)
class ViewConfig(ViewerSettings):
    """Settings of the program that shows flows, beside those of ``ViewerSettings``.

    Args:
        task: ``_target_`` and arguments of the task; a run brings its own unless ``task`` or
            ``preset`` is given, and ``task.<argument>`` changes it.
        preset: name of the preset.
        recording: a ``.rrd`` file, or a run folder with one, to open as it is.
        run: run folder whose learned fish swims.
        checkpoint: checkpoint whose fish swims.
        policy: hand-written fish that swims; ``policies.NAMES`` lists those of each task.
        recognition: as for training; a run brings its own.
        episodes: fixed starts, one flow each, of which ``flows`` are shown; all by default.
        periods: T after which episodes are left; nothing lets them end.
        seed: of the starts; 0 gives those of every run's last evaluation, 1 those that chose its
            checkpoint.
        device: cpu or cuda.
        compile: compile the flow solver.
        save: ``.rrd`` file to write; by default one in the temporary folder.
        screenshot: PNG to write instead of opening a window.
        time: of the picture, in T; by default the middle of the recording.
    """

    task: Any = MISSING
    preset: str | None = None
    recording: str | None = None
    run: str | None = None
    checkpoint: str | None = None
    policy: str | None = None
    recognition: str | None = None
    episodes: int = 1
    periods: float | None = 20.0
    seed: int = 0
    device: str = "cpu"
    compile: bool = True
    save: str | None = None
    screenshot: str | None = None
    time: float | None = None

    def __post_init__(self) -> None:
        """Refuse what cannot be shown."""
        super().__post_init__()
        _at_least("episodes", self.episodes, 1)
        if self.periods is not None and self.periods <= 0:
            raise ConfigError(f"periods = {self.periods}: must be greater than 0")
        if self.time is not None:
            _at_least("time", self.time, 0)
        sources = (self.recording, self.run, self.checkpoint, self.policy)
        if sum(source is not None for source in sources) != 1:
            raise ConfigError(
                "give one of run=<run folder>, checkpoint=<checkpoint>, policy=<hand-written "
                "fish>, such as policy=pid preset=gait_small, and the path of a .rrd file"
            )


@dataclass(kw_only=True)
class LateralLineConfig:
    """Settings of a study of the lateral line, which ends with a machine.

    Args:
        task: ``_target_`` and arguments of the task whose flows shall be told apart.
        preset: name of the preset whose task it is, if one is given; of a preset nothing else is
            taken. All flows of the stream are met, whatever ``task.start_flows`` says.
        seed: of data, splits and fits.
        device: cpu or cuda, of the flows.
        compile: compile the flow solver.
        folder: where run folders lie.
        name: of the run folder; by default made from task and seed.
        data_folder: where collected data are kept, for every study that can use them.
        num_envs: flows that advance together.
        num_samples: decisions to collect, one signal of a control interval each.
        max_decisions: after which an episode is cut.
        window: samples that the machine reads, the newest; by default those of eight intervals.
        hidden: widths of its hidden layers.
        learning_rate: of the fits.
        batch_size: of the fits.
        num_epochs: of the fits, at most.
        patience: epochs without a lower validation loss that end a fit.
        weight_decay: of the fits.
        noise: added to what the machine is fitted on, as a share of each feature's deviation.
        paper_epochs: epochs of the machine fitted as the paper does, with its other settings too.
        num_splits: divisions of the episodes over which accuracies are averaged.
        windows: lengths of window to compare, in samples.
        noises: levels of noise to compare, as shares of each feature's deviation.
        memories: to compare, of what the machine said before; see ``PredictedFlowLabel``.
    """

    task: Any = MISSING
    preset: str | None = None
    seed: int = 0
    device: str = "cpu"
    compile: bool = True
    folder: str = "runs"
    name: str | None = None
    data_folder: str = "runs/lateral_line_data"
    num_envs: int = 16
    num_samples: int = 6000
    max_decisions: int = 60
    window: int | None = None
    hidden: list[int] = field(default_factory=lambda: [128, 128])
    learning_rate: float = 1e-3
    batch_size: int = 256
    num_epochs: int = 300
    patience: int = 15
    weight_decay: float = 1e-3
    noise: float = 0.5
    paper_epochs: int = 1000
    num_splits: int = 2
    windows: list[int] = field(default_factory=lambda: [1, 2, 4, 8, 16])
    noises: list[float] = field(default_factory=lambda: [0.0, 0.1, 0.2, 0.5, 1.0])
    memories: list[float] = field(default_factory=lambda: [0.0, 0.7, 1.0])

    def __post_init__(self) -> None:
        """Refuse what cannot run."""
        for name in ("num_envs", "num_samples", "max_decisions", "batch_size", "num_epochs"):
            _at_least(name, getattr(self, name), 1)
        for name in ("patience", "paper_epochs", "num_splits"):
            _at_least(name, getattr(self, name), 1)
        for name in ("seed", "noise", "weight_decay"):
            _at_least(name, getattr(self, name), 0)
        for window in (*self.windows, 1 if self.window is None else self.window):
            _at_least("window", window, 1)
        for name, values in (("noises", self.noises), ("memories", self.memories)):
            for value in values:
                _at_least(name, value, 0)
        if self.learning_rate <= 0:
            raise ConfigError(f"learning_rate = {self.learning_rate}: must be greater than 0")


def nearest(word: str, known: Iterable[str]) -> str:
    """Give `` Did you mean 'x'?`` for the most similar known word, or nothing.

    Of dotted keys the last parts are compared: what stands before makes all of an object alike.
    """
    known = list(known)
    match = [] if "." in word else difflib.get_close_matches(word, known, n=1, cutoff=0.5)
    if not match:
        tails: dict[str, list[str]] = {}
        for name in known:
            tails.setdefault(name.rsplit(".", 1)[-1], []).append(name)
        for tail in difflib.get_close_matches(word.rsplit(".", 1)[-1], tails, n=1, cutoff=0.6):
            match = difflib.get_close_matches(word, tails[tail], n=1, cutoff=0.0)
    return f" Did you mean {match[0]!r}?" if match else ""


def _at_least(name: str, value: float, least: float) -> None:
    if value < least:
        raise ConfigError(f"{name} = {value}: must be at least {least}")


def check_device(device: str) -> None:
    """Check that a device exists here.

    Raises:
        ConfigError: if it is not one, or is a CUDA device and there is none.
    """
    import torch

    try:
        kind = torch.device(device).type
    except RuntimeError as error:
        raise ConfigError(f"device = {device!r}: must be cpu, cuda or cuda:<number>") from error
    if kind not in ("cpu", "cuda"):
        raise ConfigError(f"device = {device!r}: must be cpu, cuda or cuda:<number>")
    if kind == "cuda" and not torch.cuda.is_available():
        raise ConfigError(
            f"device = {device!r}: torch sees no CUDA device here; take device=cpu, or install a "
            "CUDA build of torch and its driver"
        )


def check_cluster(num_collectors: int) -> None:
    """Check that Ray is installed if it is wanted.

    Raises:
        ConfigError: if it is not.
    """
    if num_collectors and find_spec("ray") is None:
        raise ConfigError(
            f"ray_collectors={num_collectors}: needs Ray, which is not here; "
            "pip install 'fishrl[cluster]'"
        )
