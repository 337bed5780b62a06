"""Fits of lateral-line classifiers, scored on episodes that had no part in the fit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import torch
from tensordict import TensorDict
from torch import Tensor

from experiments.lateral_line.samples import cut_windows, mirror, select_features
from fishrl.modules import LateralLineClassifier
from fishrl.objectives import (
    Curves,
    FitSettings,
    Score,
    fit_classifier,
    score_classifier,
    split_episodes,
)

#: Shares of the episodes: to fit on, to stop by, to score on.
SHARES = (0.6, 0.2, 0.2)


@dataclass(frozen=True, kw_only=True)
class TrainingData:
    """The input of a classifier.

    Args:
        features: that it reads, names from ``KNOWN``.
        num_samples: length of the window.
        is_averaged: mean over the neuromasts.
        sensed: features of its lateral line, if there are more than it reads.
    """

    features: tuple[str, ...]
    num_samples: int
    is_averaged: bool = False
    sensed: tuple[str, ...] | None = None

    @property
    def columns(self) -> tuple[str, ...]:
        """Features of the signal."""
        return self.sensed or self.features


@dataclass(frozen=True, kw_only=True)
class Fit:
    """A classifier, its learning curves and its scores."""

    classifier: LateralLineClassifier
    curves: Curves
    fitted: Score  #: on the samples that it was fitted on, which end at any time
    held_out: Score  #: on episodes that had no part in the fit, at the decisions
    test: TensorDict  #: the samples of those


@dataclass(frozen=True, kw_only=True)
class Study:
    """Episodes, and how classifiers are fitted to them.

    Args:
        episodes: ``[E, D]`` as ``collect`` returns.
        flows: labels of the flows, as a task gives them.
        layout: description of the lateral line that recorded them, as a task gives it.
        hidden: widths of the classifiers' layers.
        settings: of the fits.
        seed: of splits and fits.
    """

    episodes: TensorDict
    flows: Sequence[dict[str, Any]]
    layout: dict[str, Any]
    hidden: Sequence[int] = (64, 64)
    settings: FitSettings = field(default_factory=FitSettings)
    seed: int = 0

    def make_generator(self, number: int) -> torch.Generator:
        """Return the generator of a split and of its fit."""
        return torch.Generator().manual_seed(1000 * self.seed + number)

    def cut(self, data: TrainingData) -> TensorDict:
        """Return the samples ``[N]`` of some training data."""
        features, is_averaged = data.columns, data.is_averaged
        selected = select_features(self.episodes, features=features, is_averaged=is_averaged)
        return cut_windows(selected, num_samples=data.num_samples)

    def fit(
        self,
        data: TrainingData,
        *,
        number: int = 0,
        split: Split | None = None,
        settings: FitSettings | None = None,
        noise: float = 0.0,
        max_samples: int | None = None,
        is_mirrored: bool = True,
    ) -> Fit:
        """Fit a classifier and score it.

        Args:
            data: its input.
            number: of the split, and of the initial weights.
            split: divides the samples; by default by episode.
            settings: of the fit, if not those of the study.
            noise: standard deviation of the noise added while fitting, as a share of each
                feature's own.
            max_samples: to fit on at most.
            is_mirrored: fit on the mirror image of each sample too.
        """
        samples = self.cut(data)
        masks = (split or split_by_episode)(self, samples, number)
        training, validation, test = (samples[mask] for mask in masks)
        test = test[test["is_whole"]]
        generator = self.make_generator(number)
        if max_samples is not None and len(training) > max_samples:
            kept = torch.randperm(len(training), generator=generator)[:max_samples]
            training = training[kept]
        if is_mirrored:
            training = torch.cat((training, self._mirror(training, data)))
        sensors = self.layout | {"features": list(data.columns)}
        if data.is_averaged:
            sensors["num_neuromasts"] = 1
        classifier = LateralLineClassifier(
            flows=self.flows,
            sensors=sensors,
            features=data.features,
            num_samples=data.num_samples,
            hidden=self.hidden,
            generator=generator,
        )
        classifier.set_normalisation(training["lateral_line"])
        curves = fit_classifier(
            classifier,
            training=training,
            validation=validation,
            settings=settings or self.settings,
            generator=generator,
            noise=noise * measure_deviation(training["lateral_line"]),
        )
        fitted, held_out = (score_classifier(classifier, part) for part in (training, test))
        return Fit(
            classifier=classifier, curves=curves, fitted=fitted, held_out=held_out, test=test
        )

    def _mirror(self, samples: TensorDict, data: TrainingData) -> TensorDict:
        flow = self.flows[0]
        num_nodes = round(flow["domain_bl"][1] * flow["body_length"])
        middle_bl = 0.5 * (num_nodes - 1) / flow["body_length"]
        image = mirror(samples["lateral_line"], features=data.columns, middle_bl=middle_bl)
        return samples.copy().set("lateral_line", image)


#: Returns masks ``[N]`` of samples: to fit on, to stop by, to score on.
Split = Callable[[Study, TensorDict, int], list[Tensor]]


def measure_deviation(signal: Tensor) -> Tensor:
    """Return the standard deviation ``[P, F]`` of each feature of signals ``[N, W, P, F]``."""
    return signal.flatten(0, 1).std(0)


def split_by_episode(study: Study, samples: TensorDict, number: int) -> list[Tensor]:
    """Split so that the parts share no episode."""
    return split_episodes(
        samples["episode"],
        samples["flow_index"],
        shares=SHARES,
        generator=study.make_generator(number),
    )


def split_by_start(study: Study, samples: TensorDict, number: int) -> list[Tensor]:
    """Split by episode; those of the last part start farther downstream than all others."""
    border = study.episodes["start"][:, 0, 0].quantile(1.0 - SHARES[2])
    is_new = samples["start"][:, 0] > border
    return [*_split_known(study, samples, number, is_known=~is_new), is_new]


def split_by_time(study: Study, samples: TensorDict, number: int) -> list[Tensor]:
    """Split by episode; samples of the last part are later in theirs than those of the others."""
    border = 0.5 * study.episodes["is_decision"].sum(1).double().mean()
    *_, test = split_by_episode(study, samples, number)
    is_late = samples["decision"] > border
    return [*_split_known(study, samples, number, is_known=~test & ~is_late), test & is_late]


def split_by_row(
    study: Study, samples: TensorDict, number: int, *, is_right_only: bool
) -> list[Tensor]:
    """Split by episode; fit on fish in the right flow's row only, or on as many in any row."""
    *parts, test = split_by_episode(study, samples, number)
    right = [part & (samples["named_flow"] == samples["flow_index"]) for part in parts]
    if is_right_only:
        return [*right, test]
    as_many = [
        part & (part.cumsum(0) <= mask.sum()) for part, mask in zip(parts, right, strict=True)
    ]
    return [*as_many, test]


def _split_known(
    study: Study, samples: TensorDict, number: int, *, is_known: Tensor
) -> list[Tensor]:
    """Divide known samples into those to fit on and those to stop by."""
    share = SHARES[0] / (SHARES[0] + SHARES[1])
    parts = split_episodes(
        samples["episode"][is_known],
        samples["flow_index"][is_known],
        shares=(share, 1.0 - share),
        generator=study.make_generator(number),
    )
    return [torch.zeros_like(is_known).masked_scatter(is_known, part) for part in parts]
