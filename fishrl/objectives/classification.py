"""Fit a classifier of signals with cross-entropy, Adam, and data that are split by episode.

Neighbouring samples of an episode are nearly equal, so that leakage would inflate the accuracy of a
split by sample. Training, validation and test parts therefore share no episode.
"""

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from typing import Annotated

import torch
from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt
from tensordict import TensorDictBase
from torch import Tensor, nn
from torch.nn.functional import cross_entropy

from fishrl.settings import Settings, checked


class FitSettings(Settings):
    """Settings of a fit.

    Args:
        learning_rate: Adam's learning rate.
        batch_size: samples per gradient step.
        num_epochs: largest number of passes over the data.
        patience: number of epochs without a lower validation loss after which the fit stops with
            the weights of the lowest loss; None runs all epochs and keeps the last weights.
        weight_decay: Adam's L2 penalty.
    """

    learning_rate: Annotated[PositiveFloat, Field(le=1)] = 1e-3
    batch_size: PositiveInt = 64
    num_epochs: PositiveInt = 300
    patience: PositiveInt | None = 30
    weight_decay: NonNegativeFloat = 0.0

    @classmethod
    def of_the_paper(cls) -> "FitSettings":
        """Return the settings of the paper for its 6000 samples."""
        return cls(learning_rate=0.01, batch_size=64, num_epochs=1000, patience=None)


@dataclass(kw_only=True)
class Curves:
    """Loss and accuracy per epoch; ``chosen_epoch`` (from 0) gave the final weights.

    Training values are means over the epoch, during which the weights change.
    """

    train_loss: list[float] = field(default_factory=list)
    train_accuracy: list[float] = field(default_factory=list)
    validation_loss: list[float] = field(default_factory=list)
    validation_accuracy: list[float] = field(default_factory=list)
    chosen_epoch: int = 0


@dataclass(frozen=True, kw_only=True)
class Score:
    """Scores of a classifier on a data set."""

    accuracy: float  #: share of correctly classified samples
    loss: float  #: mean cross-entropy, in nats
    #: ``[n, n]`` int64, samples of each true class (row) by predicted class (column)
    confusion: Tensor


@checked
def split_episodes(
    episode: Tensor, label: Tensor, *, shares: Sequence[float], generator: torch.Generator
) -> list[Tensor]:
    """Split samples into parts without common episodes, each with episodes of every class.

    Args:
        episode: episode of each sample, ``[N]`` int64.
        label: class of each sample, ``[N]`` int64; the first sample gives the class of an episode.
        shares: share of the episodes for each part; positive, with sum 1.
        generator: draws the episodes of each part.

    Returns:
        A mask ``[N]`` bool per part.

    Raises:
        ValueError: for invalid shares, or if a class has fewer episodes than parts.
    """
    if min(shares) <= 0.0 or abs(sum(shares) - 1.0) > 1e-6:
        raise ValueError(f"shares = {shares}: must be positive and sum to 1")
    parts = [torch.zeros_like(label, dtype=torch.bool) for _ in shares]
    known, at = episode.unique(return_inverse=True)
    place = torch.arange(len(at), device=at.device)
    first = place.new_full(known.shape, len(at)).scatter_reduce(0, at, place, "amin")
    for kind in label[first].unique():
        ids = known[label[first] == kind]
        if len(ids) < len(shares):
            raise ValueError(
                f"class {int(kind)} has {len(ids)} episodes for {len(shares)} parts: collect at "
                "least one per part"
            )
        ids = ids[torch.randperm(len(ids), generator=generator)]
        # one episode for each part, the rest by shares
        cumulative = torch.tensor([0.0, *shares], dtype=torch.float64).cumsum(0)
        ends = (cumulative * (len(ids) - len(shares))).round().long()
        ends = ends + torch.arange(len(shares) + 1)
        for part, start, end in zip(parts, ends[:-1], ends[1:], strict=True):
            part |= torch.isin(episode, ids[start:end])
    return parts


@checked
def fit_classifier(
    classifier: nn.Module,
    *,
    training: TensorDictBase,
    validation: TensorDictBase,
    settings: FitSettings,
    generator: torch.Generator,
    noise: Tensor | float = 0.0,
) -> Curves:
    """Fit a classifier in place.

    Args:
        classifier: network from signals ``[N, ...]`` to logits ``[N, n]``.
        training: TensorDict ``[N]`` with ``lateral_line`` and ``flow_index`` ``[N]`` int64.
        validation: samples of other episodes, used only for early stopping.
        settings: see ``FitSettings``.
        generator: draws batches and noise.
        noise: standard deviation of Gaussian noise on the signals, broadcast over them.

    Raises:
        ValueError: if a part is empty or not finite.
    """
    for name, part in (("training", training), ("validation", validation)):
        if part.shape[0] == 0:
            raise ValueError(f"{name} holds no samples: collect more or change the shares")
        if not part["lateral_line"].isfinite().all():
            raise ValueError(f"{name} holds NaN or infinity: exclude diverged episodes")
    optimiser = torch.optim.Adam(
        classifier.parameters(), lr=settings.learning_rate, weight_decay=settings.weight_decay
    )
    curves, best_loss, kept = Curves(), float("inf"), None
    for epoch in range(settings.num_epochs):
        loss, accuracy = _fit_epoch(
            classifier, training, optimiser, settings.batch_size, generator, noise
        )
        score = score_classifier(classifier, validation)
        curves.train_loss.append(loss)
        curves.train_accuracy.append(accuracy)
        curves.validation_loss.append(score.loss)
        curves.validation_accuracy.append(score.accuracy)
        if settings.patience is None or score.loss < best_loss:
            best_loss, curves.chosen_epoch = score.loss, epoch
            kept = deepcopy(classifier.state_dict()) if settings.patience else None
        elif epoch - curves.chosen_epoch >= settings.patience:
            break
    if kept is not None:
        classifier.load_state_dict(kept)
    classifier.eval()
    return curves


def _fit_epoch(
    classifier: nn.Module,
    data: TensorDictBase,
    optimiser: torch.optim.Optimizer,
    batch_size: int,
    generator: torch.Generator,
    noise: Tensor | float,
) -> tuple[float, float]:
    """Fit once to all data; return mean loss and accuracy, during which the weights change."""
    signals, labels = data["lateral_line"], data["flow_index"]
    has_noise = bool(torch.as_tensor(noise).any())
    classifier.train()
    loss_sum, num_right = signals.new_zeros(()), labels.new_zeros(())
    for batch in torch.randperm(len(labels), generator=generator).split(batch_size):
        signal, label = signals[batch], labels[batch]
        if has_noise:
            drawn = torch.randn(signal.shape, generator=generator, dtype=signal.dtype)
            signal = signal + noise * drawn.to(signal.device)
        logits = classifier(signal)
        loss = cross_entropy(logits, label)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        loss_sum += loss.detach() * len(batch)
        num_right += (logits.argmax(-1) == label).sum()
    return float(loss_sum) / len(labels), float(num_right) / len(labels)


@checked
@torch.no_grad()
def score_classifier(classifier: nn.Module, data: TensorDictBase) -> Score:
    """Score a classifier on ``data`` (see ``fit_classifier``) and leave it in ``eval`` mode."""
    classifier.eval()
    logits, label = classifier(data["lateral_line"]), data["flow_index"]
    num = logits.shape[-1]
    named = logits.argmax(-1)
    return Score(
        accuracy=float((named == label).double().mean()),
        loss=float(cross_entropy(logits, label)),
        confusion=torch.bincount(label * num + named, minlength=num * num).view(num, num),
    )
