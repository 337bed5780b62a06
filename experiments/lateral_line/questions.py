"""Questions of the study: each is a fit and the accuracies read from it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import torch
from torch import Tensor

from experiments.lateral_line.study import (
    Fit,
    Split,
    Study,
    TrainingData,
    measure_deviation,
    split_by_episode,
    split_by_row,
    split_by_start,
    split_by_time,
)
from fishrl.envs.lateral_line import LOCAL, PAPER
from fishrl.modules.lateral_line import BOOKKEEPING
from fishrl.objectives import score_classifier
from fishrl.training.progress import Progress

#: Accuracies by column and row, one value per division of the episodes.
Answers = dict[str, dict[str, list[float]]]


class Question(NamedTuple):
    """A fit of the study; see ``Study.fit``."""

    data: TrainingData
    noise: float = 0.0
    split: Split = split_by_episode


def answer(
    study: Study,
    *,
    window: int,
    windows: Sequence[int],
    noises: Sequence[float],
    memories: Sequence[float],
    num_splits: int,
    progress: Progress,
) -> dict[str, Answers]:
    """Return tables of held-out accuracies by name; equal fits are made once.

    The longest window has ``window`` samples; ``windows``, ``noises`` and ``memories`` are those of
    ``LateralLineSettings``.
    """
    local = TrainingData(features=LOCAL, num_samples=window)
    plain, inputs = Question(local), list_training_data(window)
    by_length = {n: Question(replace(local, num_samples=n)) for n in windows}
    by_noise = {level: Question(local, noise=level) for level in noises}
    splits = {
        "new episodes": split_by_episode,
        "new starts": split_by_start,
        "later times": split_by_time,
    }
    by_input = {
        (name, column): Question(data, split=split)
        for name, data in inputs.items()
        for column, split in splits.items()
    }
    by_row = {
        name: Question(local, split=partial(split_by_row, is_right_only=is_right_only))
        for name, is_right_only in (("any row", False), ("the right row", True))
    }
    groups = (by_length, by_noise, by_input, by_row)
    questions = dict.fromkeys([plain, *(q for group in groups for q in group.values())])
    progress.start("comparisons", total=num_splits * len(questions))
    tables: dict[str, Answers] = {}

    def note(table: str, column: str, row: str, *values: float) -> None:
        rows = tables.setdefault(table, {}).setdefault(column, {})
        rows.setdefault(row, []).extend(values)

    for number in range(num_splits):
        fits: dict[Question, Fit] = {}
        for question in questions:
            fits[question] = study.fit(number=number, **question._asdict())
            progress.advance(1)
        test = fits[plain].test
        for memory in memories:
            is_correct = predict(fits[plain], memory=memory)
            note("memory", "accuracy", f"{memory:g}", _mean(is_correct))
            for decision in test["decision"].unique().tolist():
                values = is_correct[test["decision"] == decision].double().tolist()
                note("by_decision", f"{memory:g}", str(decision), *values)
        for length, question in by_length.items():
            note("windows", "accuracy", str(length), fits[question].held_out.accuracy)
        for level, question in by_noise.items():
            for column, fit in (("without", fits[plain]), ("with this", fits[question])):
                accuracy = score_with_noise(fit, level)
                note("noise", f"fitted {column} noise", f"{level:g}", accuracy)
        for name, data in inputs.items():
            note("leaks", "fitted", name, fits[Question(data)].fitted.accuracy)
        for (name, column), question in by_input.items():
            note("leaks", column, name, fits[question].held_out.accuracy)
        for name, question in by_row.items():
            fit, is_correct = fits[question], predict(fits[question])
            is_right = fit.test["named_flow"] == fit.test["flow_index"]
            for column, mask in (("in the right row", is_right), ("in a wrong row", ~is_right)):
                note("rows", column, f"fitted on fish in {name}", _mean(is_correct[mask]))
    return tables


def list_training_data(window: int) -> dict[str, TrainingData]:
    """Return the inputs to compare, by name; the longest window has ``window`` samples."""
    some = tuple(name for name in PAPER if name not in BOOKKEEPING)
    mean = tuple(name for name in LOCAL if name != "pressure")  # whose mean is 0
    instant = partial(TrainingData, num_samples=1)
    return {
        "paper: instant, mean of the neuromasts": instant(features=PAPER, is_averaged=True),
        "the same without t, x, y": instant(features=some, is_averaged=True),
        "t, x, y alone": instant(features=BOOKKEEPING, is_averaged=True),
        "local: instant, mean of the neuromasts": instant(features=mean, is_averaged=True),
        "local: instant, each neuromast": instant(features=LOCAL),
        "paper: whole window, each neuromast": TrainingData(features=PAPER, num_samples=window),
        "local: whole window, each neuromast": TrainingData(features=LOCAL, num_samples=window),
    }


def score_with_noise(fit: Fit, level: float) -> float:
    """Return the held-out accuracy with noise, in shares of the features' standard deviations."""
    signal = fit.test["lateral_line"]
    drawn = torch.randn(signal.shape, generator=torch.Generator().manual_seed(0))
    noisy = signal + level * measure_deviation(signal) * drawn
    return score_classifier(fit.classifier, fit.test.copy().set("lateral_line", noisy)).accuracy


@torch.no_grad()
def predict(fit: Fit, *, memory: float = 0.0) -> Tensor:
    """Return ``[N]`` whether each held-out prediction is correct.

    ``memory`` is the weight of the evidence at the decision before, see ``PredictedFlowLabel``.
    """
    log_probabilities = fit.classifier(fit.test["lateral_line"]).log_softmax(-1)
    ids, episode = fit.test["episode"].unique(return_inverse=True)
    decision = fit.test["decision"]
    shape = (len(ids), int(decision.max()) + 1, log_probabilities.shape[-1])
    evidence = log_probabilities.new_zeros(shape)
    evidence[episode, decision] = log_probabilities
    for i in range(1, evidence.shape[1]):
        evidence[:, i] += memory * evidence[:, i - 1]
    label = evidence[episode, decision].argmax(-1)
    is_correct: Tensor = label == fit.test["flow_index"]
    return is_correct


def _mean(is_correct: Tensor) -> float:
    return float(is_correct.double().mean())
