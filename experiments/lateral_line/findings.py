"""The questions that are put to a lateral line, and their answers as plain numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import torch
from tensordict import TensorDict
from torch import Tensor

from experiments.lateral_line.study import (
    Diet,
    Fit,
    Study,
    diets,
    measure_deviation,
    split_by_start,
    split_by_time,
)
from fishrl.envs.lateral_line import LOCAL
from fishrl.objectives import Score, score_classifier

#: Accuracies of several splits, by what was asked.
Answers = dict[str, list[float]]
Report = Callable[[], None]


def find_window(
    study: Study, *, lengths: Sequence[int], num_splits: int, on_fit: Report
) -> Answers:
    """Return held-out accuracies by the number of samples in the window."""
    answers: Answers = {}
    for length in lengths:
        diet = Diet(features=LOCAL, num_samples=length)
        answers[str(length)] = []
        for number in range(num_splits):
            answers[str(length)].append(study.fit(diet, number=number).held_out.accuracy)
            on_fit()
    return answers


def find_noise(
    study: Study, diet: Diet, *, levels: Sequence[float], num_splits: int, on_fit: Report
) -> dict[str, Answers]:
    """Return held-out accuracies by noise, of machines fitted without noise and with the same."""
    answers: dict[str, Answers] = {"fitted without noise": {}, "fitted with this noise": {}}
    for number in range(num_splits):
        calm = study.fit(diet, number=number)
        on_fit()
        for level in levels:
            trained = calm if level == 0.0 else study.fit(diet, number=number, noise=level)
            on_fit()
            for name, fit in zip(answers, (calm, trained), strict=True):
                accuracy = score_with_noise(fit, noise=level).accuracy
                answers[name].setdefault(f"{level:g}", []).append(accuracy)
    return answers


def find_leaks(study: Study, *, window: int, num_splits: int, on_fit: Report) -> dict[str, Answers]:
    """Return accuracies of each diet on what it was fitted on and on three kinds of new data."""
    answers: dict[str, Answers] = {}
    for name, diet in diets(window).items():
        found: Answers = {"fitted": [], "new episodes": [], "new starts": [], "later times": []}
        for number in range(num_splits):
            fit = study.fit(diet, number=number)
            found["fitted"].append(fit.fitted.accuracy)
            found["new episodes"].append(fit.held_out.accuracy)
            on_fit()
            for kind, split in (
                ("new starts", split_by_start(study, number=number)),
                ("later times", split_by_time(study, number=number)),
            ):
                fit = study.fit(diet, number=number, split=split)
                found[kind].append(fit.held_out.accuracy)
                on_fit()
        answers[name] = found
    return answers


def find_confirmation(
    study: Study, diet: Diet, *, num_splits: int, on_fit: Report
) -> dict[str, Answers]:
    """Return accuracies where the fish beats in the right flow's row and in a wrong one.

    Of two machines: one fitted on fish in any row, one only on fish in the row of the flow that
    they are in, as data with the true label at hand would have them. Both get as many samples.
    """
    answers: dict[str, Answers] = {}
    for name, is_strict in (("any row", False), ("the right row", True)):
        found: Answers = {"in the right row": [], "in a wrong row": []}
        for number in range(num_splits):
            split = partial(_split_by_row, study, number=number, is_strict=is_strict)
            fit = study.fit(diet, number=number, split=split)
            on_fit()
            is_named = name_flows(fit)
            is_right = fit.test["named_flow"] == fit.test["flow_index"]
            for kind, mask in zip(found, (is_right, ~is_right), strict=True):
                found[kind].append(float(is_named[mask].double().mean()))
        answers[f"fitted on fish in {name}"] = found
    return answers


def _split_by_row(study: Study, data: TensorDict, *, number: int, is_strict: bool) -> list[Tensor]:
    """Split as usual, but fit only on fish in the right row, or on as many in any row."""
    *parts, test = study.split(data, number)
    is_right = data["named_flow"] == data["flow_index"]
    masks = [part & is_right for part in parts]
    if not is_strict:
        masks = [
            part & (part.cumsum(0) <= mask.sum()) for part, mask in zip(parts, masks, strict=True)
        ]
    return [*masks, test]


def find_memory(
    study: Study, diet: Diet, *, memories: Sequence[float], num_splits: int, on_fit: Report
) -> dict[str, Any]:
    """Return accuracies of naming the flow by all that was felt so far; see ``PredictedFlowLabel``.

    ``overall`` by memory, and ``by_decision`` for each memory the mean by the number of decisions
    since the start.
    """
    overall: Answers = {f"{memory:g}": [] for memory in memories}
    by_decision: dict[str, dict[int, list[Tensor]]] = {name: {} for name in overall}
    for number in range(num_splits):
        fit = study.fit(diet, number=number)
        on_fit()
        for memory, name in zip(memories, overall, strict=True):
            is_named = name_flows(fit, memory=memory)
            overall[name].append(float(is_named.double().mean()))
            decision = fit.test["decision"]
            for i in decision.unique().tolist():
                by_decision[name].setdefault(i, []).append(is_named[decision == i])
    means = {
        name: {str(i): float(torch.cat(found).double().mean()) for i, found in sorted(all_.items())}
        for name, all_ in by_decision.items()
    }
    return {"overall": overall, "by_decision": means}


@torch.no_grad()
def score_with_noise(fit: Fit, *, noise: float, seed: int = 0) -> Score:
    """Judge a machine on its held-out samples with noise, in shares of features' deviations."""
    generator = torch.Generator().manual_seed(seed)
    signal = fit.test["lateral_line"]
    drawn = torch.randn(signal.shape, generator=generator)
    noisy = signal + noise * measure_deviation(signal) * drawn
    return score_classifier(fit.machine, fit.test.copy().set("lateral_line", noisy))


@torch.no_grad()
def name_flows(fit: Fit, *, memory: float = 0.0) -> Tensor:
    """Return ``[N]`` whether each held-out sample is named rightly, with memory of those before."""
    said = fit.machine(fit.test["lateral_line"]).log_softmax(-1)
    ids, episode = fit.test["episode"].unique(return_inverse=True)
    decision = fit.test["decision"]
    dense = said.new_zeros(len(ids), int(decision.max()) + 1, said.shape[-1])
    dense[episode, decision] = said
    evidence = torch.zeros_like(dense)
    for i in range(dense.shape[1]):
        before = evidence[:, i - 1] if i else 0.0
        evidence[:, i] = memory * before + dense[:, i]
    named = evidence[episode, decision].argmax(-1)
    is_right: Tensor = named == fit.test["flow_index"]
    return is_right


def describe_fit(fit: Fit) -> dict[str, Any]:
    """Return the numbers of a fit that are kept."""
    return {
        "fitted_accuracy": fit.fitted.accuracy,
        "held_out_accuracy": fit.held_out.accuracy,
        "held_out_loss": fit.held_out.loss,
        "held_out_samples": len(fit.test),
        "held_out_episodes": int(fit.test["episode"].unique().numel()),
        "confusion": fit.held_out.confusion.tolist(),
        "epochs": len(fit.curves.train_loss),
        "chosen_epoch": fit.curves.chosen_epoch,
    }
