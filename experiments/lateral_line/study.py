"""What a lateral line can tell, and what it cannot: fits judged by episodes they never saw."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from experiments.lateral_line.samples import cut_windows, mirror, select_features
from fishrl.envs.lateral_line import LOCAL, PAPER
from fishrl.modules import LateralLineClassifier
from fishrl.modules.lateral_line import BOOKKEEPING
from fishrl.objectives import (
    Curves,
    FitSettings,
    Score,
    fit_classifier,
    score_classifier,
    split_episodes,
)

#: Of the episodes: to fit on, to stop by, to judge by.
SHARES = (0.6, 0.2, 0.2)


@dataclass(frozen=True, kw_only=True)
class Diet:
    """What a machine is fed.

    Args:
        features: that it reads, names from ``KNOWN``.
        num_samples: length of the window.
        is_averaged: mean over the neuromasts.
        told: features that its lateral line tells, if it tells more than is read.
    """

    features: tuple[str, ...]
    num_samples: int
    is_averaged: bool = False
    told: tuple[str, ...] | None = None


@dataclass(frozen=True, kw_only=True)
class Fit:
    """A machine, how it came about, and how it does.

    Attributes:
        fitted: score on the samples that it was fitted on, which end at any time.
        held_out: score on episodes that had no part in the fit, at the decisions.
        test: the samples of those.
    """

    machine: LateralLineClassifier
    curves: Curves
    fitted: Score
    held_out: Score
    test: TensorDict


@dataclass(frozen=True, kw_only=True)
class Study:
    """Episodes, and how machines are made of them.

    Args:
        episodes: ``[E, D]`` as ``collect`` returns.
        flows: labels of the flows, as a task gives them.
        layout: description of the lateral line that recorded them, as a task gives it.
        hidden: widths of the machines' layers.
        settings: of the fits.
        seed: of splits and fits.
    """

    episodes: TensorDict
    flows: Sequence[dict[str, Any]]
    layout: dict[str, Any]
    hidden: Sequence[int] = (64, 64)
    settings: FitSettings = field(default_factory=FitSettings)
    seed: int = 0

    def cut(self, diet: Diet) -> TensorDict:
        """Return the samples ``[N]`` that a diet is made of."""
        told = diet.told or diet.features
        felt = select_features(self.episodes, features=told, is_averaged=diet.is_averaged)
        return cut_windows(felt, num_samples=diet.num_samples)

    def describe(self, diet: Diet) -> dict[str, Any]:
        """Return the layout of a lateral line that tells what a diet is made of."""
        changes: dict[str, Any] = {"features": list(diet.told or diet.features)}
        if diet.is_averaged:
            changes["num_neuromasts"] = 1
        return self.layout | changes

    def split(self, data: TensorDictBase, number: int = 0) -> list[Tensor]:
        """Return masks ``[N]`` of the parts to fit on, to stop by and to judge by."""
        generator = torch.Generator().manual_seed(1000 * self.seed + number)
        return split_episodes(
            data["episode"], data["flow_index"], shares=SHARES, generator=generator
        )

    def fit(
        self,
        diet: Diet,
        *,
        number: int = 0,
        settings: FitSettings | None = None,
        noise: float = 0.0,
        split: Callable[[TensorDict], Sequence[Tensor]] | None = None,
        max_samples: int | None = None,
        is_mirrored: bool = True,
    ) -> Fit:
        """Fit a machine and judge it.

        Args:
            diet: what it is fed.
            number: of the split, and of the initial weights.
            settings: of the fit, if not the usual ones.
            noise: deviation of what is added while fitting, as a share of each feature's own.
            split: masks of the three parts, if not the usual ones by episode.
            max_samples: to fit on at most.
            is_mirrored: fit on the mirror image of each sample too.
        """
        data = self.cut(diet)
        masks = self.split(data, number) if split is None else split(data)
        training, validation, test = (data[mask] for mask in masks)
        test = test[test["is_whole"]]
        generator = torch.Generator().manual_seed(1000 * self.seed + number)
        if max_samples is not None and len(training) > max_samples:
            kept = torch.randperm(len(training), generator=generator)[:max_samples]
            training = training[kept]
        if is_mirrored:
            training = torch.cat((training, self._mirror(training, diet)))
        machine = LateralLineClassifier(
            flows=self.flows,
            sensors=self.describe(diet),
            features=diet.features,
            num_samples=diet.num_samples,
            hidden=self.hidden,
            generator=generator,
        )
        machine.set_normalisation(training["lateral_line"])
        curves = fit_classifier(
            machine,
            training=training,
            validation=validation,
            settings=settings or self.settings,
            generator=generator,
            noise=noise * measure_deviation(training["lateral_line"]),
        )
        return Fit(
            machine=machine,
            curves=curves,
            fitted=score_classifier(machine, training),
            held_out=score_classifier(machine, test),
            test=test,
        )

    def _mirror(self, data: TensorDict, diet: Diet) -> TensorDict:
        flow = self.flows[0]
        num_nodes = round(flow["domain_bl"][1] * flow["body_length"])
        image = mirror(
            data["lateral_line"],
            features=diet.told or diet.features,
            middle_bl=0.5 * (num_nodes - 1) / flow["body_length"],
        )
        return data.copy().set("lateral_line", image)


def measure_deviation(signal: Tensor) -> Tensor:
    """Return the standard deviation ``[P, F]`` of each feature of signals ``[N, W, P, F]``."""
    return signal.flatten(0, 1).std(0)


def diets(window: int) -> dict[str, Diet]:
    """Return what is compared, by name; ``window`` is the number of samples in the longest."""
    some = tuple(name for name in PAPER if name not in BOOKKEEPING)
    mean = tuple(name for name in LOCAL if name != "pressure")  # whose mean is 0
    return {
        "paper: instant, mean of the neuromasts": Diet(
            features=PAPER, num_samples=1, is_averaged=True
        ),
        "the same without t, x, y": Diet(features=some, num_samples=1, is_averaged=True),
        "t, x, y alone": Diet(features=BOOKKEEPING, num_samples=1, is_averaged=True),
        "local: instant, mean of the neuromasts": Diet(
            features=mean, num_samples=1, is_averaged=True
        ),
        "local: instant, each neuromast": Diet(features=LOCAL, num_samples=1),
        "paper: whole window, each neuromast": Diet(features=PAPER, num_samples=window),
        "local: whole window, each neuromast": Diet(features=LOCAL, num_samples=window),
    }


def split_by_start(study: Study, *, number: int = 0) -> Callable[[TensorDict], list[Tensor]]:
    """Return a split whose last part started farther downstream than all the others did."""
    start = study.episodes["start"][:, 0, 0]
    border = start.quantile(1.0 - SHARES[2])

    def split(data: TensorDict) -> list[Tensor]:
        is_new = data["start"][:, 0] > border
        return _split_rest(study, data, is_new=is_new, is_known=~is_new, number=number)

    return split


def split_by_time(study: Study, *, number: int = 0) -> Callable[[TensorDict], list[Tensor]]:
    """Return a split whose last part is later in its episodes than the others, other ones too."""
    num_decisions = study.episodes["is_decision"].sum(1)
    border = 0.5 * num_decisions.double().mean()

    def split(data: TensorDict) -> list[Tensor]:
        *_, test = study.split(data, number)
        is_late = data["decision"] > border
        return _split_rest(
            study, data, is_new=test & is_late, is_known=~test & ~is_late, number=number
        )

    return split


def _split_rest(
    study: Study, data: TensorDict, *, is_new: Tensor, is_known: Tensor, number: int
) -> list[Tensor]:
    """Divide what is known into parts to fit on and to stop by."""
    share = SHARES[0] / (SHARES[0] + SHARES[1])
    parts = split_episodes(
        data["episode"][is_known],
        data["flow_index"][is_known],
        shares=(share, 1.0 - share),
        generator=torch.Generator().manual_seed(1000 * study.seed + number),
    )
    masks = []
    for part in parts:
        mask = torch.zeros_like(is_known)
        mask[is_known] = part
        masks.append(mask)
    return [*masks, is_new]
