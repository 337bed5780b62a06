"""Files of tensors: neither changed bits nor wrong content are read."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from experiments.gait import trials
from fishrl.envs import Flows
from fishrl.envs.steering import load_weights, save_weights
from fishrl.envs.wakes import WakeBank, load_wakes
from fishrl.files import load_tensors
from fishrl.modules import LateralLineClassifier
from fishrl.programs.lateral_line.collection import CollectionSettings, collect
from fishrl.training.checkpoint import Checkpoint, save_checkpoint
from fishrl.training.policy_spec import PolicySpec
from tests.envs.test_wakes import RECIPE
from tests.experiments.gait.tasks import BRIEF, make_task
from tests.programs.lateral_line import signals
from tests.sines import FLOWS, SENSORS
from tests.training.conftest import renew_checksums
from tests.wrong_files import TEXTS, flip, is_equal, spoil, try_all

#: Makes a file in a folder, and returns the function that reads it there.
Maker = Callable[[Path, pytest.MonkeyPatch], Callable[[], Any]]


def make_classifier(folder: Path, _: pytest.MonkeyPatch) -> Callable[[], Any]:
    LateralLineClassifier(flows=FLOWS, sensors=SENSORS, hidden=(4,)).save(folder / "classifier.pt")

    def read() -> Any:
        classifier = LateralLineClassifier.load(folder / "classifier.pt")
        classifier.check(flows=classifier.flows, sensors=classifier.sensors)
        shape = (classifier.num_intervals * 16, 5, len(classifier.sensors["features"]))
        assert classifier(torch.zeros(2, *shape)).isfinite().all()
        return classifier.state_dict(), classifier.flows, classifier.sensors

    return read


def make_wakes(folder: Path, patch: pytest.MonkeyPatch) -> Callable[[], Any]:
    recipe = replace(RECIPE, config=replace(RECIPE.config, width=24, height=16), num_phases=2)
    populations, rates = torch.rand(1, 2, 9, 16, 24), torch.rand(1, dtype=torch.float64)
    bank = WakeBank(populations=populations, shedding_frequencies=rates)
    patch.setattr("fishrl.envs.wakes.develop_wakes", lambda *_: bank)
    load_wakes(recipe, folder)
    return lambda: vars(load_wakes(recipe, folder))


def make_steering(folder: Path, _: pytest.MonkeyPatch) -> Callable[[], Any]:
    layers = [(torch.rand(m, n), torch.rand(m)) for n, m in ((16, 4), (4, 3))]
    save_weights(layers, folder / "weights.pt")
    return lambda: load_weights(folder / "weights.pt")


def make_policy(folder: Path, _: pytest.MonkeyPatch) -> Callable[[], Any]:
    spec = PolicySpec(task="Predation", num_inputs=3, num_actions=2)
    net = torch.nn.Linear(3, 2)
    save_checkpoint(folder / "best", {"actor": net}, spec=spec, frames=7, config={})

    def read() -> Any:
        renew_checksums(folder / "best")  # as whoever changes it on purpose
        Checkpoint.find(folder / "best").load({"actor": net}, spec=spec)
        return net.state_dict()

    return read


def make_data(folder: Path, patch: pytest.MonkeyPatch) -> Callable[[], Any]:
    patch.setattr(CollectionSettings, "place", folder)
    given: Any = {
        "task": signals.make_task(),
        "flows": Flows(num_envs=2),
        "max_decisions": 2,
        "num_samples": 1,
    }
    settings = CollectionSettings(**given, data_folder=str(folder))
    piece = {
        "lateral_line": torch.rand(2, 2, signals.INTERVAL, 3, 12),
        "is_decision": torch.ones(2, 2, dtype=torch.bool),
        "flow_index": torch.zeros(2, 2, dtype=torch.int64),
    }
    torch.save(piece, settings.place / "piece-0000.pt")
    return lambda: collect(settings).to_dict()


def make_histories(folder: Path, patch: pytest.MonkeyPatch) -> Callable[[], Any]:
    trial = trials.make_trial("bang_bang", make_task(), periods=BRIEF)
    rows = {"flow": torch.arange(3), "lengths_T": torch.rand(3)}
    rows |= {name: torch.ones(3, dtype=torch.bool) for name in ("terminated", "diverged")}
    other = {name: torch.full((3, 4), torch.nan).double() for name in trials.Histories._fields}
    patch.setattr(trials, "record", lambda *_, **__: trials.Histories(**other | rows))
    trials.run_trial(trial, episodes=1, folder=folder)
    return lambda: trials.run_trial(trial, episodes=1, folder=folder)


MAKERS = (make_classifier, make_wakes, make_steering, make_policy, make_data, make_histories)


@pytest.fixture(params=MAKERS, ids=lambda make: make.__name__.removeprefix("make_"))
def stored(
    request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> tuple[Path, Callable[[], Any]]:
    """Return a file of each kind, and what reads it."""
    read = request.param(tmp_path, monkeypatch)
    return next(tmp_path.rglob("*.pt")), read


def test_no_flipped_bit_changes_what_is_read(stored: tuple[Path, Callable[[], Any]]) -> None:
    path, read = stored
    whole, data = read(), path.read_bytes()

    def read_flipped(content: bytes) -> None:
        path.write_bytes(content)
        assert is_equal(read(), whole)  # a few bits fill up the file

    try_all((("flip", content) for content in flip(data, random.Random(0))), read_flipped)


def test_wrong_content_is_refused_in_one_line(stored: tuple[Path, Callable[[], Any]]) -> None:
    path, read = stored
    tree = torch.load(path)

    def read_tree(content: Any) -> None:
        path.unlink()
        path.write_bytes(content) if isinstance(content, bytes) else torch.save(content, path)
        read()

    counts = try_all(spoil(tree, random.Random(1)), read_tree)
    assert counts["refused"] > counts["read"]
    assert not try_all(((str(text[:9]), text) for text in TEXTS[:3]), read_tree)["read"]


def test_a_missing_file_is_refused_with_the_remedy(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"wakes .*none: no such file; delete it"):
        load_tensors(tmp_path / "none", what="wakes", remedy="delete it")
