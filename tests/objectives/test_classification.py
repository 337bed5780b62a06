"""The fit of a classifier: it learns, other episodes judge it, and one seed gives one fit."""

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


def test_parts_share_no_episode_and_have_those_of_each_class_in_about_its_share() -> None:
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


@pytest.mark.parametrize("empty", [0, 1])
def test_impossible_shares_and_parts_without_samples_are_refused(empty: int) -> None:
    data, wrong = make_samples(8), r"shares = \(0.9, 0.9\): must be positive and of sum 1"
    for shares, message in ((SHARES, "class 2 has 2 episodes for 3 parts"), ((0.9, 0.9), wrong)):
        with pytest.raises(ValueError, match=message):
            split_episodes(
                data["episode"], data["flow_index"], shares=shares, generator=generator()
            )
    parts = make_parts(9)
    parts[empty] = parts[empty][:0]
    with pytest.raises(ValueError, match="holds no samples"):
        fit(make_network(), parts)
    parts = make_parts(9)
    parts[empty]["lateral_line"][0] = torch.nan
    with pytest.raises(ValueError, match="NaN"):
        fit(make_network(), parts)


def test_a_fit_classifies_sines_of_unseen_episodes() -> None:
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


def test_one_seed_gives_one_fit_whatever_the_global_generator_does() -> None:
    parts = make_parts(12)
    networks = [make_network() for _ in range(2)]
    for seed, network in enumerate(networks):
        torch.manual_seed(seed)
        fit(network, parts, settings=FitSettings(num_epochs=2), noise=0.1)
    for a, b in zip(*(network.parameters() for network in networks), strict=True):
        assert torch.equal(a, b)


@pytest.mark.parametrize("patience", [5, None])
def test_a_patient_fit_keeps_the_weights_of_the_lowest_validation_loss_and_others_the_last(
    patience: int | None,
) -> None:
    parts, network = make_parts(12), make_network()
    num_epochs = 200 if patience else 3
    settings = FitSettings(learning_rate=0.05, num_epochs=num_epochs, patience=patience)
    curves = fit(network, parts, settings=settings)
    losses = curves.validation_loss
    chosen = losses.index(min(losses)) if patience else 2
    assert curves.chosen_epoch == chosen == len(losses) - 1 - (patience or 0)
    assert (len(losses) < num_epochs) is bool(patience)
    assert score_classifier(network, parts[1]).loss == pytest.approx(losses[chosen])


def test_noise_on_a_feature_keeps_the_fit_from_relying_on_it() -> None:
    parts = make_parts()
    names = torch.zeros(6)
    names[3:5] = 100.0  # the two that tell
    network = make_network()
    fit(network, parts, noise=names)
    assert score_classifier(network, parts[0]).accuracy < 0.6
