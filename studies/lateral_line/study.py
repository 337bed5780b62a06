"""Classifiers fitted to some samples of the episodes and scored on others, and what they answer."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from operator import attrgetter
from typing import Any, NamedTuple

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from experiments.lateral_line.collection import CollectionSettings
from fishrl.bounds import bounded
from fishrl.envs.lateral_line import KNOWN, LOCAL, PAPER
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
from fishrl.training.progress import Progress

#: Control intervals that the classifier reads by default.
NUM_INTERVALS = 8
#: Shares of the episodes: to fit on, to stop by, to score on.
SHARES = (0.6, 0.2, 0.2)
#: Features that change their sign in a mirror along the stream.
_ODD = ("u_y", "left", "shear")

#: Accuracies by column and row, one value per division of the episodes.
Answers = dict[str, dict[str, list[float]]]
#: Returns masks ``[N]`` of samples, to fit on, to stop by, to score on; given these, the episodes
#: that they come from, and a seed.
Split = Callable[[TensorDict, TensorDict, int], list[Tensor]]


@dataclass(frozen=True, kw_only=True)
class LateralLineSettings(CollectionSettings, FitSettings):
    """Settings of a study of the lateral line, besides those of its data and fits.

    Args:
        folder: folder of all run folders.
        name: name of the run folder; by default made from task and seed.
        window: samples that the classifier reads, the newest; by default those of eight intervals.
        hidden: widths of its hidden layers.
        is_recurrent: read the window sample by sample with a GRU.
        noise: noise added to the training signals, as a share of each feature's standard deviation.
        paper_epochs: epochs of the paper's classifier, which is fitted with its settings.
        num_splits: divisions of the episodes over which accuracies are averaged.
        windows: lengths of window to compare, in samples.
        noises: levels of noise to compare, as shares of each feature's standard deviation.
        memories: weights of earlier predictions to compare, see ``PredictedFlowLabel``.
    """

    folder: str = "runs"
    name: str | None = None
    window: int | None = bounded(None, least=1)
    hidden: tuple[int, ...] = bounded((128, 128), least=1)
    batch_size: int = bounded(256, least=1)
    patience: int | None = bounded(15, least=1)
    is_recurrent: bool = False
    weight_decay: float = bounded(1e-3, least=0)
    noise: float = bounded(0.5, least=0)
    paper_epochs: int = bounded(1000, least=1)
    num_splits: int = bounded(2, least=1)
    windows: tuple[int, ...] = bounded((1, 2, 4, 8, 16), least=1)
    noises: tuple[float, ...] = bounded((0.0, 0.1, 0.2, 0.5, 1.0), least=0)
    memories: tuple[float, ...] = bounded((0.0, 0.7, 1.0), least=0)


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

    Before the start the first sample is repeated, as the environment does. ``episodes`` are
    ``[E, D]`` as ``collect`` returns.

    Returns:
        TensorDict ``[N]`` with ``lateral_line`` ``[N, num_samples, P, F]``; ``decision``, the
        number (from 0) of the decision that the last sample precedes; ``is_whole``, whether the
        window ends right at the decision; and the other entries of ``episodes``.
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
    samples["decision"], samples["is_whole"] = (v.expand(rows, -1) for v in (decision, is_whole))
    samples["lateral_line"] = windows
    return samples[is_used]


def split_by_episode(samples: TensorDict, episodes: TensorDict, seed: int) -> list[Tensor]:
    """Split so that the parts share no episode."""
    return _divide(samples, SHARES, seed)


def split_by_start(samples: TensorDict, episodes: TensorDict, seed: int) -> list[Tensor]:
    """Split by episode; those of the last part start farther downstream than all others."""
    border = episodes["start"][:, 0, 0].quantile(1.0 - SHARES[2])
    is_new = samples["start"][:, 0] > border
    return [*_divide_known(samples, ~is_new, seed), is_new]


def split_by_time(samples: TensorDict, episodes: TensorDict, seed: int) -> list[Tensor]:
    """Split by episode; samples of the last part are later in theirs than those of the others."""
    border = 0.5 * episodes["is_decision"].sum(1).double().mean()
    *_, test = split_by_episode(samples, episodes, seed)
    is_late = samples["decision"] > border
    return [*_divide_known(samples, ~test & ~is_late, seed), test & is_late]


def split_by_row(
    samples: TensorDict, episodes: TensorDict, seed: int, *, is_right_only: bool
) -> list[Tensor]:
    """Split by episode; fit on fish in the right flow's row only, or on as many in any row."""
    *parts, test = split_by_episode(samples, episodes, seed)
    right = [part & (samples["named_flow"] == samples["flow_index"]) for part in parts]
    if is_right_only:
        return [*right, test]
    pairs = zip(parts, right, strict=True)
    return [*(part & (part.cumsum(0) <= mask.sum()) for part, mask in pairs), test]


#: How samples are divided, by column of the table of leakage.
SPLITS: dict[str, Split] = {
    "new episodes": split_by_episode,
    "new starts": split_by_start,
    "later times": split_by_time,
}


def _divide(samples: TensorDict, shares: Sequence[float], seed: int) -> list[Tensor]:
    generator = torch.Generator().manual_seed(seed)
    labels = (samples["episode"], samples["flow_index"])
    return split_episodes(*labels, shares=shares, generator=generator)


def _divide_known(samples: TensorDict, is_known: Tensor, seed: int) -> list[Tensor]:
    """Divide known samples into those to fit on and those to stop by."""
    share = SHARES[0] / (SHARES[0] + SHARES[1])
    parts = _divide(samples[is_known], (share, 1.0 - share), seed)
    return [torch.zeros_like(is_known).masked_scatter(is_known, part) for part in parts]


@dataclass(frozen=True, kw_only=True)
class Question:
    """What a classifier reads, and how it is fitted."""

    features: tuple[str, ...]  #: names from ``KNOWN``
    num_samples: int = 1  #: length of the window
    is_averaged: bool = False  #: read the mean over the neuromasts
    sensed: tuple[str, ...] | None = None  #: features of its lateral line, if more than it reads
    noise: float = 0.0  #: added while fitting, in shares of each feature's standard deviation
    split: Split = split_by_episode
    settings: FitSettings | None = None  #: by default those of the study
    max_samples: int | None = None  #: to fit on at most
    is_mirrored: bool = True  #: fit on the mirror image of each sample too
    is_recurrent: bool = False  #: read the window sample by sample

    @property
    def columns(self) -> tuple[str, ...]:
        """Features of the signal."""
        return self.sensed or self.features


class Fit(NamedTuple):
    """A classifier, its learning curves and its scores."""

    classifier: LateralLineClassifier
    curves: Curves
    fitted: Score  #: on the samples that it was fitted on, which end at any time
    held_out: Score  #: on episodes that had no part in the fit, at the decisions
    test: TensorDict  #: the samples of those

    @torch.no_grad()
    def predict(self, *, memory: float = 0.0) -> Tensor:
        """Return ``[N]`` whether each held-out prediction is correct.

        ``memory`` is the weight of the evidence at the decision before, see ``PredictedFlowLabel``.
        """
        log_probabilities = self.classifier(self.test["lateral_line"]).log_softmax(-1)
        ids, episode = self.test["episode"].unique(return_inverse=True)
        decision = self.test["decision"]
        shape = (len(ids), int(decision.max()) + 1, log_probabilities.shape[-1])
        evidence = log_probabilities.new_zeros(shape)
        evidence[episode, decision] = log_probabilities
        for i in range(1, evidence.shape[1]):
            evidence[:, i] += memory * evidence[:, i - 1]
        is_correct: Tensor = evidence[episode, decision].argmax(-1) == self.test["flow_index"]
        return is_correct

    def score(self, *, memory: float = 0.0, is_right: bool | None = None) -> float:
        """Return the accuracy of ``predict``, in the right row of frequencies or a wrong one."""
        is_correct = self.predict(memory=memory)
        if is_right is not None:
            in_right_row = self.test["named_flow"] == self.test["flow_index"]
            is_correct = is_correct[in_right_row == is_right]
        return float(is_correct.double().mean())

    def score_with_noise(self, level: float) -> float:
        """Return the held-out accuracy with noise, in shares of the standard deviations."""
        signal = self.test["lateral_line"]
        drawn = torch.randn(signal.shape, generator=torch.Generator().manual_seed(0))
        noisy = signal + level * measure_deviation(signal) * drawn
        return score_classifier(
            self.classifier, self.test.copy().set("lateral_line", noisy)
        ).accuracy


def measure_deviation(signal: Tensor) -> Tensor:
    """Return the standard deviation ``[P, F]`` of each feature of signals ``[N, W, P, F]``."""
    return signal.flatten(0, 1).std(0)


class Study:
    """Episodes ``[E, D]`` as ``collect`` returns, and how classifiers are fitted to them."""

    def __init__(self, settings: LateralLineSettings, episodes: TensorDict) -> None:
        self.settings, self.episodes = settings, episodes
        self.flows: Sequence[dict[str, Any]] = settings.task.flow_labels
        self.layout: dict[str, Any] = settings.recorded_task.lateral_line_layout
        self.window = settings.window or NUM_INTERVALS * settings.task.lateral_line.num_samples

    def cut(self, question: Question) -> TensorDict:
        """Return the samples ``[N]`` that a classifier reads."""
        columns = [KNOWN.index(name) for name in question.columns]
        signal = self.episodes["lateral_line"][..., columns]
        if question.is_averaged:
            signal = signal.mean(-2, keepdim=True)
        episodes = self.episodes.copy().set("lateral_line", signal)
        return cut_windows(episodes, num_samples=question.num_samples)

    def fit(self, question: Question, *, number: int = 0) -> Fit:
        """Fit a classifier and score it; ``number`` is that of the split and initial weights."""
        q, seed = question, 1000 * self.settings.seed + number
        samples, generator = self.cut(q), torch.Generator().manual_seed(seed)
        masks = q.split(samples, self.episodes, seed)
        training, validation, test = (samples[mask] for mask in masks)
        test = test[test["is_whole"]]
        if q.max_samples is not None and len(training) > q.max_samples:
            training = training[torch.randperm(len(training), generator=generator)[: q.max_samples]]
        if q.is_mirrored:
            flow, signal = self.flows[0], training["lateral_line"]
            num_nodes = round(flow["domain_bl"][1] * flow["body_length"])
            middle_bl = 0.5 * (num_nodes - 1) / flow["body_length"]
            image = mirror(signal, features=q.columns, middle_bl=middle_bl)
            training = torch.cat((training, training.copy().set("lateral_line", image)))
        sensors = self.layout | {"features": list(q.columns)}
        if q.is_averaged:
            sensors["num_neuromasts"] = 1
        classifier = LateralLineClassifier(
            flows=self.flows,
            sensors=sensors,
            features=q.features,
            num_samples=q.num_samples,
            hidden=self.settings.hidden,
            is_recurrent=q.is_recurrent,
            generator=generator,
        )
        classifier.set_normalisation(training["lateral_line"])
        curves = fit_classifier(
            classifier,
            training=training,
            validation=validation,
            settings=q.settings or self.settings,
            generator=generator,
            noise=q.noise * measure_deviation(training["lateral_line"]),
        )
        fitted, held_out = (score_classifier(classifier, part) for part in (training, test))
        return Fit(classifier, curves, fitted, held_out, test)

    def fit_own(self) -> Fit:
        """Fit the classifier of the task's lateral line."""
        s, line = self.settings, self.settings.task.lateral_line
        features = tuple(name for name in line.features if name not in BOOKKEEPING)
        own: Any = {"is_averaged": line.is_averaged, "sensed": line.features, "noise": s.noise}
        own["is_recurrent"] = s.is_recurrent
        return self.fit(Question(features=features, num_samples=self.window, **own))

    def fit_paper(self) -> Fit:
        """Fit a classifier as the paper does."""
        s, paper = self.settings, FitSettings.of_the_paper()
        settings = replace(paper, num_epochs=s.paper_epochs)
        how: Any = {"settings": settings, "max_samples": s.num_samples, "is_mirrored": False}
        return self.fit(Question(features=PAPER, is_averaged=True, **how))

    def answer(self, progress: Progress) -> dict[str, Answers]:
        """Return tables of held-out accuracies by name; equal fits are made once."""
        s, inputs = self.settings, list_inputs(self.window)
        plain = inputs["local: whole window, each neuromast"]
        entries: list[tuple[str, str, str, Question, Callable[[Fit], float]]] = []
        tables: Any = defaultdict(lambda: defaultdict(lambda: defaultdict(list)))
        held_out = attrgetter("held_out.accuracy")

        def ask(
            table: str, column: str, row: str, question: Question, read: Any = held_out
        ) -> None:
            entries.append((table, column, row, question, read))

        for memory in s.memories:
            ask("memory", "accuracy", f"{memory:g}", plain, partial(Fit.score, memory=memory))
        for length in s.windows:
            ask("windows", "accuracy", str(length), replace(plain, num_samples=length))
        for level in s.noises:
            read = partial(Fit.score_with_noise, level=level)
            ask("noise", "fitted without noise", f"{level:g}", plain, read)
            ask("noise", "fitted with this noise", f"{level:g}", replace(plain, noise=level), read)
        for name, question in inputs.items():
            ask("leaks", "fitted", name, question, attrgetter("fitted.accuracy"))
            for column, split in SPLITS.items():
                ask("leaks", column, name, replace(question, split=split))
        for name, is_right_only in (("any row", False), ("the right row", True)):
            question = replace(plain, split=partial(split_by_row, is_right_only=is_right_only))
            for column, is_right in (("in the right row", True), ("in a wrong row", False)):
                row, read = f"fitted on fish in {name}", partial(Fit.score, is_right=is_right)
                ask("rows", column, row, question, read)
        questions = dict.fromkeys(question for *_, question, _ in entries)
        progress.start("comparisons", total=s.num_splits * len(questions))
        for number in range(s.num_splits):
            fits: dict[Question, Fit] = {}
            for question in questions:
                fits[question] = self.fit(question, number=number)
                progress.advance(1)
            for table, column, row, question, read_fit in entries:
                tables[table][column][row].append(read_fit(fits[question]))
            decision = fits[plain].test["decision"]
            for memory in s.memories:
                is_correct = fits[plain].predict(memory=memory).double()
                for count in decision.unique().tolist():
                    values = is_correct[decision == count].tolist()
                    tables["by_decision"][f"{memory:g}"][str(count)] += values
        return dict(tables)


def list_inputs(window: int) -> dict[str, Question]:
    """Return the inputs to compare, by name; the longest window has ``window`` samples."""
    some = tuple(name for name in PAPER if name not in BOOKKEEPING)
    mean = tuple(name for name in LOCAL if name != "pressure")  # whose mean is 0
    return {
        "paper: instant, mean of the neuromasts": Question(features=PAPER, is_averaged=True),
        "the same without t, x, y": Question(features=some, is_averaged=True),
        "t, x, y alone": Question(features=BOOKKEEPING, is_averaged=True),
        "local: instant, mean of the neuromasts": Question(features=mean, is_averaged=True),
        "local: instant, each neuromast": Question(features=LOCAL),
        "paper: whole window, each neuromast": Question(features=PAPER, num_samples=window),
        "local: whole window, each neuromast": Question(features=LOCAL, num_samples=window),
    }
