"""Samples cut from episodes, and classifiers fitted to some of them and scored on others."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from fishrl.envs.lateral_line import KNOWN
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
#: Features that change their sign in a mirror along the stream.
_ODD = ("u_y", "left", "shear")


def select_features(
    episodes: TensorDict, *, features: Sequence[str], is_averaged: bool
) -> TensorDict:
    """Return episodes as ``collect`` does, with some features (of ``KNOWN``) of the signal only.

    If ``is_averaged``, only the mean over the neuromasts is kept.
    """
    signal = episodes["lateral_line"][..., [KNOWN.index(name) for name in features]]
    if is_averaged:
        signal = signal.mean(-2, keepdim=True)
    return episodes.copy().set("lateral_line", signal)


def mirror(signal: Tensor, *, features: Sequence[str], middle_bl: float) -> Tensor:
    """Return the signal ``[N, W, P, F]`` of the mirror image of a fish in that of its flow.

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
        if name in _ODD:
            image[..., number].neg_()
        elif name == "y":
            image[..., number] = 2.0 * middle_bl - image[..., number]
    return image


def cut_windows(episodes: TensorDictBase, *, num_samples: int) -> TensorDict:
    """Cut the signal of each episode into windows, one that ends at each of its samples.

    Before the start the first sample is repeated, as the environment does.

    Args:
        episodes: ``[E, D]`` as ``collect`` returns.
        num_samples: length of the windows.

    Returns:
        TensorDict ``[N]`` with ``lateral_line`` ``[N, num_samples, P, F]``; ``decision``, the
        number (from 0) of the decision that the last sample precedes; ``is_whole``, whether the
        window ends right at the decision; and the other entries of ``episodes``.

    Raises:
        ValueError: for windows without samples.
    """
    if num_samples < 1:
        raise ValueError(f"num_samples = {num_samples}: a window has at least 1")
    signal = episodes["lateral_line"]
    rows, num_decisions, interval = signal.shape[:3]
    series = signal.flatten(1, 2)  # [E, D * W, P, F]
    first = series[:, :1].expand(-1, num_samples - 1, -1, -1)
    windows = torch.cat((first, series), 1).unfold(1, num_samples, 1).movedim(-1, 2)
    is_whole = (torch.arange(num_decisions * interval) + 1) % interval == 0
    decision = torch.arange(num_decisions).repeat_interleave(interval)
    is_used = episodes["is_decision"].repeat_interleave(interval, 1)
    is_used &= is_whole | (decision > 0)  # at reset all samples of the interval are the first one
    kept = {
        "decision": decision.expand(rows, -1),
        "is_whole": is_whole.expand(rows, -1),
        **{
            str(name): value.repeat_interleave(interval, 1)
            for name, value in episodes.items()
            if name not in ("lateral_line", "is_decision")
        },
    }
    cut = {name: value[is_used] for name, value in kept.items()}
    return TensorDict({"lateral_line": windows[is_used], **cut}, [int(is_used.sum())])


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
