"""Fits of the lateral-line classifier: accuracy, episode split, seeds, early stopping."""

from typing import Any

import pytest
import torch
from tensordict import TensorDict
from torch import nn

from fishrl.modules import LateralLineClassifier
from fishrl.objectives import Curves, FitSettings, fit_classifier, score_classifier, split_episodes
from tests.sines import FLOWS, SENSORS, make_samples

SHARES = (0.6, 0.2, 0.2)


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def make_parts(num_episodes: int = 60) -> list[TensorDict]:
    data = make_samples(num_episodes)
    masks = split_episodes(
        data["episode"], data["flow_index"], shares=SHARES, generator=generator()
    )
    return [data[mask] for mask in masks]


def make_network(seed: int = 0) -> LateralLineClassifier:
    machine = LateralLineClassifier(
        flows=FLOWS, sensors=SENSORS, hidden=(32,), generator=generator(seed)
    )
    machine.set_normalisation(make_samples(9)["lateral_line"])
    return machine


def fit(network: nn.Module, parts: list[TensorDict], **changes: Any) -> Curves:
    arguments: dict[str, Any] = {
        "settings": FitSettings(learning_rate=0.003, num_epochs=40),
        "generator": generator(),
    }
    return fit_classifier(network, training=parts[0], validation=parts[1], **(arguments | changes))


def test_split_is_by_episode_and_stratified_by_class() -> None:
    episode = torch.arange(60).repeat_interleave(10)
    constant = episode % 3
    changing = (episode + torch.arange(10).repeat(60) // 5) % 3  # after five samples
    for label in (constant, changing):
        masks = split_episodes(episode, label, shares=SHARES, generator=generator())
        assert torch.equal(sum(mask.int() for mask in masks), torch.ones_like(label).int())
        assert sum(episode[mask].unique().numel() for mask in masks) == 60
        for mask, share in zip(masks, SHARES, strict=True):
            per_class = label[mask].view(-1, 10)[:, 0].bincount(minlength=3)
            assert per_class.tolist() == [pytest.approx(20 * share, abs=1)] * 3


def test_fit_classifies_unseen_episodes() -> None:
    parts, network = make_parts(), make_network()
    before = score_classifier(network, parts[2])
    curves = fit(network, parts)
    after = score_classifier(network, parts[2])
    assert before.accuracy < 0.6
    assert after.accuracy > 0.95  # the frequencies differ by factors of 2 and 1.5
    assert curves.train_loss[-1] < 0.5 * curves.train_loss[0]
    assert curves.train_accuracy[-1] > 0.95


def test_confusion_counts_true_classes_in_rows() -> None:
    said = torch.tensor([[9.0, 0.0, 0.0], [0.0, 9.0, 0.0], [0.0, 9.0, 0.0]])
    data = TensorDict({"lateral_line": said, "flow_index": torch.arange(3)}, [3])
    score = score_classifier(nn.Identity(), data)
    assert score.confusion.tolist() == [[1, 0, 0], [0, 1, 0], [0, 1, 0]]
    assert score.accuracy == pytest.approx(2 / 3)


@pytest.mark.parametrize("patience", [5, None])
def test_patience_keeps_weights_of_lowest_validation_loss(patience: int | None) -> None:
    parts, network = make_parts(12), make_network()
    num_epochs = 200 if patience else 3
    settings = FitSettings(learning_rate=0.05, num_epochs=num_epochs, patience=patience)
    curves = fit(network, parts, settings=settings)
    losses = curves.validation_loss
    chosen = losses.index(min(losses)) if patience else 2
    assert curves.chosen_epoch == chosen == len(losses) - 1 - (patience or 0)
    assert (len(losses) < num_epochs) is bool(patience)
    assert score_classifier(network, parts[1]).loss == pytest.approx(losses[chosen])


def test_noisy_features_are_not_used() -> None:
    parts, network, noise = make_parts(), make_network(), torch.zeros(6)
    noise[3:5] = 100.0  # the informative features u and v
    fit(network, parts, noise=noise, settings=FitSettings(learning_rate=0.003, num_epochs=10))
    assert score_classifier(network, parts[0]).accuracy < 0.6
