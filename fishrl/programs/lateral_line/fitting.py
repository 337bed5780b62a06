"""Classifiers, fitted to the signals of some episodes and scored on those of others."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import torch
from pydantic import NonNegativeFloat, NonNegativeInt, PositiveInt
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from fishrl.envs.lateral_line import KNOWN, PAPER, LateralLine
from fishrl.envs.senses import REVERSED
from fishrl.modules import LateralLineClassifier
from fishrl.objectives import (
    Curves,
    FitSettings,
    Score,
    fit_classifier,
    score_classifier,
    split_episodes,
)
from fishrl.programs.lateral_line.collection import CollectionSettings

#: Control intervals that the classifier reads by default.
NUM_INTERVALS = 8
#: Shares of the episodes: to fit on, to stop by, to score on.
SHARES = (0.6, 0.2, 0.2)


class LateralLineSettings(CollectionSettings, FitSettings):
    """Settings of a classifier, besides those of its data and fit.

    Args:
        folder: folder of all run folders.
        name: name of the run folder; by default made from task and seed.
        window: samples that the classifier reads, the newest; by default those of eight intervals.
        reads: features of the task's lateral line that it reads; by default all but time and
            position.
        hidden: widths of its hidden layers.
        noise: noise added to the training signals, as a share of each feature's standard deviation.
        is_mirrored: fit on the mirror image of each sample too.
        max_samples: samples to fit on at most; by default all.
        paper_epochs: epochs of a classifier as in the paper, fitted for comparison; 0 for none.
    """

    folder: str = "runs"
    name: str | None = None
    window: PositiveInt | None = None
    reads: tuple[str, ...] | None = None
    hidden: tuple[PositiveInt, ...] = (128, 128)
    batch_size: int = 256
    patience: int | None = 15
    weight_decay: float = 1e-3
    noise: NonNegativeFloat = 0.5
    is_mirrored: bool = True
    max_samples: PositiveInt | None = None
    paper_epochs: NonNegativeInt = 0

    @property
    def line(self) -> LateralLine:
        """The lateral line of the task."""
        task: Any = self.task
        line: LateralLine = task.lateral_line
        return line

    @property
    def num_read(self) -> int:
        """Number of samples that the classifier reads."""
        return self.window or NUM_INTERVALS * self.line.num_samples

    def as_in_the_paper(self) -> "LateralLineSettings":
        """Return the settings of the paper's classifier, fitted to the same data."""
        task: Any = self.task
        line = replace(self.line, features=PAPER, is_averaged=True)
        return replace(
            self,
            task=replace(task, lateral_line=line),
            window=1,
            reads=PAPER,
            noise=0.0,
            is_mirrored=False,
            max_samples=self.num_samples,
            **vars(replace(FitSettings.of_the_paper(), num_epochs=self.paper_epochs)),
        )


def mirror(signal: Tensor, *, features: Sequence[str], middle_bl: float) -> Tensor:
    """Return the signal ``[N, W, P, F]`` of a fish and flow mirrored along the stream.

    Flow, disc and fish are symmetric about y = ``middle_bl``, so the image is as valid a sample as
    the original; a learned heading controller, which need not be symmetric, is mirrored with them.
    Neuromasts are as ``LateralLine`` orders them, or their mean.
    """
    num = signal.shape[2]
    order = list(range(num))
    for right in range(num % 2, num, 2):
        order[right], order[right + 1] = right + 1, right
    image = signal[:, :, order].clone()
    for number, name in enumerate(features):
        if name in REVERSED:
            image[..., number].neg_()
        elif name == "y":
            image[..., number] = 2.0 * middle_bl - image[..., number]
    return image


def cut_windows(episodes: TensorDictBase, *, num_samples: int) -> TensorDict:
    """Cut the signal of each episode into windows, one ending at each sample.

    Before the start the first sample is repeated, as the environment does. ``episodes`` are
    ``[E, D]`` as ``collect`` returns.

    Returns:
        TensorDict ``[N]`` with ``lateral_line`` ``[N, num_samples, P, F]``; ``is_whole``, whether
        the window ends right at a decision; and the other entries of ``episodes``.
    """
    signal = episodes["lateral_line"]
    rows, num_decisions, interval = signal.shape[:3]
    series = signal.flatten(1, 2)  # [E, D * W, P, F]
    first = series[:, :1].expand(-1, num_samples - 1, -1, -1)
    windows = torch.cat((first, series), 1).unfold(1, num_samples, 1).movedim(-1, 2)
    is_whole = (torch.arange(num_decisions * interval) + 1) % interval == 0
    decision = torch.arange(num_decisions).repeat_interleave(interval)
    samples = episodes.exclude("lateral_line").apply(
        lambda entry: entry.repeat_interleave(interval, 1), batch_size=[rows, len(decision)]
    )
    is_used = samples["is_decision"]
    # at reset all samples of the interval are the first one
    is_used = is_used & (is_whole | (decision > 0))
    samples["is_whole"] = is_whole.expand(rows, -1)
    samples["lateral_line"] = windows
    return samples[is_used]


class Fit(NamedTuple):
    """A classifier, its learning curves and its scores."""

    classifier: LateralLineClassifier
    curves: Curves
    fitted: Score  #: on the samples that it was fitted on, which end at any time
    held_out: Score  #: on episodes that had no part in the fit, at the decisions
    test: TensorDict  #: the samples of those


def cut_samples(episodes: TensorDict, settings: LateralLineSettings) -> TensorDict:
    """Return the samples ``[N]`` that a classifier reads, from episodes as ``collect`` returns."""
    columns = [KNOWN.index(name) for name in settings.line.features]
    signal = episodes["lateral_line"][..., columns]
    if settings.line.is_averaged:
        signal = signal.mean(-2, keepdim=True)
    episodes = episodes.copy().set("lateral_line", signal)
    return cut_windows(episodes, num_samples=settings.num_read)


def fit(settings: LateralLineSettings, episodes: TensorDict) -> Fit:
    """Fit a classifier to some of the episodes and score it on others."""
    samples = cut_samples(episodes, settings)
    divider, generator = (torch.Generator().manual_seed(1000 * settings.seed) for _ in range(2))
    labels = samples["episode"], samples["flow_index"]
    masks = split_episodes(*labels, shares=SHARES, generator=divider)
    training, validation, test = (samples[mask] for mask in masks)
    test = test[test["is_whole"]]
    if settings.max_samples is not None and len(training) > settings.max_samples:
        drawn = torch.randperm(len(training), generator=generator)
        training = training[drawn[: settings.max_samples]]
    task: Any = settings.task
    flows: Sequence[dict[str, Any]] = task.flow_labels
    if settings.is_mirrored:
        signal, middle_bl = training["lateral_line"], task.origin[1] / task.body_length
        image = mirror(signal, features=settings.line.features, middle_bl=middle_bl)
        training = torch.cat((training, training.copy().set("lateral_line", image)))
    classifier = LateralLineClassifier(
        flows=flows,
        sensors=task.lateral_line_layout,
        features=settings.reads,
        num_samples=settings.num_read,
        hidden=settings.hidden,
        generator=generator,
    )
    classifier.set_normalisation(training["lateral_line"])
    deviation = training["lateral_line"].flatten(0, 1).std(0)  # [P, F]
    curves = fit_classifier(
        classifier,
        training=training,
        validation=validation,
        settings=settings,
        generator=generator,
        noise=settings.noise * deviation,
    )
    fitted, held_out = (score_classifier(classifier, part) for part in (training, test))
    return Fit(classifier, curves, fitted, held_out, test)
