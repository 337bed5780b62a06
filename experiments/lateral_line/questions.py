"""Questions of the study: each is a fit and the accuracies read from it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

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

#: Column, row and values of a table of accuracies.
Reading = tuple[str, str, list[float]]
#: Accuracies by column and row, one value per division of the episodes.
Answers = dict[str, dict[str, list[float]]]


@dataclass(frozen=True, kw_only=True)
class Question:
    """A fit for each division of the episodes, and what is read from it.

    Args:
        table: name of the table for the accuracies.
        data: the classifier's input.
        read: returns the accuracies of a fit.
        noise: see ``Study.fit``.
        split: see ``Study.fit``.
    """

    table: str
    data: TrainingData
    read: Callable[[Fit], Iterator[Reading]]
    noise: float = 0.0
    split: Split = split_by_episode


def answer(
    study: Study, questions: Sequence[Question], *, num_splits: int, on_answer: Callable[[], None]
) -> dict[str, Answers]:
    """Return the accuracies of each table by column and row; equal fits are made once."""
    tables: dict[str, Answers] = {question.table: {} for question in questions}
    for number in range(num_splits):
        fits: dict[Any, Fit] = {}
        for question in questions:
            data, noise, split = key = (question.data, question.noise, question.split)
            if key not in fits:
                fits[key] = study.fit(data, number=number, noise=noise, split=split)
            for column, row, values in question.read(fits[key]):
                rows = tables[question.table].setdefault(column, {})
                rows.setdefault(row, []).extend(values)
            on_answer()
    return tables


def list_questions(
    *,
    window: int,
    windows: Sequence[int],
    noises: Sequence[float],
    memories: Sequence[float],
) -> list[Question]:
    """Return the questions of a study.

    Args:
        window: number of samples in the longest window.
        windows: lengths of window to compare.
        noises: levels to compare, as shares of each feature's standard deviation.
        memories: of earlier predictions to compare, see ``PredictedFlowLabel``.
    """
    local = TrainingData(features=LOCAL, num_samples=window)
    questions = [
        Question(table="memory", data=local, read=partial(read_memory, memories=memories)),
        Question(table="by_decision", data=local, read=partial(read_decisions, memories=memories)),
    ]
    for length in windows:
        data = TrainingData(features=LOCAL, num_samples=length)
        read = partial(read_held_out, column="accuracy", row=str(length))
        questions.append(Question(table="windows", data=data, read=read))
    without = partial(read_noise, column="fitted without noise", levels=noises)
    questions.append(Question(table="noise", data=local, read=without))
    for level in noises:
        trained = partial(read_noise, column="fitted with this noise", levels=[level])
        questions.append(Question(table="noise", data=local, read=trained, noise=level))
    for name, data in list_training_data(window).items():
        questions.append(Question(table="leaks", data=data, read=partial(read_fit, row=name)))
        for column, split in (("new starts", split_by_start), ("later times", split_by_time)):
            read = partial(read_held_out, column=column, row=name)
            questions.append(Question(table="leaks", data=data, read=read, split=split))
    for name, is_right_only in (("any row", False), ("the right row", True)):
        read = partial(read_rows, row=f"fitted on fish in {name}")
        division = partial(split_by_row, is_right_only=is_right_only)
        questions.append(Question(table="rows", data=local, read=read, split=division))
    return questions


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


def read_held_out(fit: Fit, *, column: str, row: str) -> Iterator[Reading]:
    """Read the accuracy on held-out episodes."""
    yield column, row, [fit.held_out.accuracy]


def read_fit(fit: Fit, *, row: str) -> Iterator[Reading]:
    """Read the accuracies on what was fitted and on held-out episodes."""
    yield "fitted", row, [fit.fitted.accuracy]
    yield "new episodes", row, [fit.held_out.accuracy]


def read_noise(fit: Fit, *, column: str, levels: Sequence[float]) -> Iterator[Reading]:
    """Read held-out accuracies with noise, in shares of the features' standard deviations."""
    signal = fit.test["lateral_line"]
    for level in levels:
        drawn = torch.randn(signal.shape, generator=torch.Generator().manual_seed(0))
        noisy = signal + level * measure_deviation(signal) * drawn
        score = score_classifier(fit.classifier, fit.test.copy().set("lateral_line", noisy))
        yield column, f"{level:g}", [score.accuracy]


def read_rows(fit: Fit, *, row: str) -> Iterator[Reading]:
    """Read held-out accuracies of fish in the right flow's row of frequencies and in another's."""
    is_correct = predict(fit)
    is_right = fit.test["named_flow"] == fit.test["flow_index"]
    for column, mask in (("in the right row", is_right), ("in a wrong row", ~is_right)):
        yield column, row, [float(is_correct[mask].double().mean())]


def read_memory(fit: Fit, *, memories: Sequence[float]) -> Iterator[Reading]:
    """Read held-out accuracies by memory of earlier predictions."""
    for memory in memories:
        yield "accuracy", f"{memory:g}", [float(predict(fit, memory=memory).double().mean())]


def read_decisions(fit: Fit, *, memories: Sequence[float]) -> Iterator[Reading]:
    """Read for each memory and decision since the start which held-out samples are correct."""
    decision = fit.test["decision"]
    for memory in memories:
        is_correct = predict(fit, memory=memory)
        for number in decision.unique().tolist():
            yield f"{memory:g}", str(number), is_correct[decision == number].double().tolist()


@torch.no_grad()
def predict(fit: Fit, *, memory: float = 0.0) -> Tensor:
    """Return ``[N]`` whether each held-out prediction is correct.

    Args:
        fit: whose classifier predicts.
        memory: weight of the evidence at the decision before, see ``PredictedFlowLabel``.
    """
    log_probabilities = fit.classifier(fit.test["lateral_line"]).log_softmax(-1)
    ids, episode = fit.test["episode"].unique(return_inverse=True)
    decision = fit.test["decision"]
    evidence = log_probabilities.new_zeros(
        len(ids), int(decision.max()) + 1, log_probabilities.shape[-1]
    )
    evidence[episode, decision] = log_probabilities
    for i in range(1, evidence.shape[1]):
        evidence[:, i] += memory * evidence[:, i - 1]
    label = evidence[episode, decision].argmax(-1)
    is_correct: Tensor = label == fit.test["flow_index"]
    return is_correct
