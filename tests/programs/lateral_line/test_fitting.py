"""Lateral-line classifiers: from episodes to windows, what is learned, and what is written."""

import json
from math import pi
from pathlib import Path

import torch
from tensordict import TensorDict

from fishrl.envs.lateral_line import KNOWN, LOCAL, LateralLine
from fishrl.modules import LateralLineClassifier
from fishrl.physics import Fish, FlowConfig, InPlaceSolver
from fishrl.physics.flow import make_uniform
from fishrl.programs.lateral_line.fitting import cut_samples, cut_windows, fit, mirror
from fishrl.programs.lateral_line.report import tabulate
from fishrl.programs.train_lateral_line import train_lateral_line
from tests.programs.lateral_line.signals import INTERVAL, make_episodes, make_settings, make_task

#: Two episodes of at most three decisions with four samples each, numbered; one neuromast.
SIGNAL = torch.arange(24.0).view(2, 3, 4, 1, 1)


def make_numbered_episodes() -> TensorDict:
    signal = SIGNAL.clone()
    signal[:, 0] = signal[:, 0, :1]  # at reset the first sample is repeated
    return TensorDict(
        {
            "lateral_line": signal,
            "is_decision": torch.tensor([[True, True, True], [True, True, False]]),
            "flow_index": torch.tensor([[0, 0, 0], [1, 1, 1]]),
            "episode": torch.tensor([[7, 7, 7], [8, 8, 8]]),
        },
        [2, 3],
    )


def windows_of(data: TensorDict) -> list[list[int]]:
    return data["lateral_line"].squeeze(-1).squeeze(-1).int().tolist()


def test_mirrored_signal_is_that_of_mirrored_fish() -> None:
    length, size = 20, (50, 60)
    generator = torch.Generator().manual_seed(0)
    rho, ux, uy = 0.02 * torch.randn(3, 1, *size, generator=generator)
    line = LateralLine(num_neuromasts=5, features=KNOWN)
    felt = []
    for sign, heading in ((1.0, pi - 0.3), (-1.0, pi + 0.3)):
        config = FlowConfig(width=60, height=50, tau=0.6, bodies=(Fish(body_length=length),))
        solver = InPlaceSolver(config=config, frequency=0.0, compile=False)
        place, all_rows = torch.tensor([[30.0, 24.5]]), torch.ones(1, dtype=torch.bool)
        solver.reset_(all_rows, place, torch.tensor([heading]))
        flow = [rho, ux, sign * uy]
        solver.set_populations_(
            make_uniform(*(field if sign > 0 else field.flip(1) for field in flow))
        )
        signal, _ = line.sense(solver, torch.zeros(1).long(), body_length=length, period=200)
        felt.append(signal[:, None])
    image = mirror(felt[0], features=KNOWN, middle_bl=24.5 / length)
    torch.testing.assert_close(image, felt[1], rtol=1e-4, atol=1e-4)
    assert (felt[0] - felt[1]).abs().max() > 0.1


def test_window_before_start_repeats_first_sample() -> None:
    data = cut_windows(make_numbered_episodes(), num_samples=6)
    data = data[data["is_whole"]]
    rows = ((0, 0, 0, 0, 0, 0), (0, 0, 4, 5, 6, 7), (6, 7, 8, 9, 10, 11))
    assert windows_of(data)[:3] == [list(row) for row in rows]
    assert data["episode"].tolist() == [7, 7, 7, 8, 8]
    assert data["flow_index"].tolist() == [0, 0, 0, 1, 1]


def test_windows_end_at_every_sample_after_reset() -> None:
    data = cut_windows(make_numbered_episodes(), num_samples=1)
    assert windows_of(data) == [[k] for k in (0, *range(4, 12), 12, *range(16, 20))]
    data = cut_windows(make_numbered_episodes(), num_samples=2)
    assert windows_of(data)[:4] == [[0, 0], [0, 4], [4, 5], [5, 6]]
    later = [False, False, False, True]
    assert data["is_whole"].tolist() == [True, *later, *later, True, *later]


def test_classifier_reads_selected_features_or_mean() -> None:
    episodes = make_episodes()
    signal = episodes["lateral_line"][0, 0, -1:]  # of the first whole interval
    lines = (
        LateralLine(num_neuromasts=3, features=("slip", "u_x"), is_averaged=is_averaged)
        for is_averaged in (False, True)
    )
    tasks = (make_task(lateral_line=line) for line in lines)
    each, mean = (cut_samples(episodes, make_settings(task=task, window=1)) for task in tasks)
    assert torch.equal(each["lateral_line"][0, ..., 1], signal[..., KNOWN.index("u_x")])
    torch.testing.assert_close(mean["lateral_line"], each["lateral_line"].mean(-2, keepdim=True))


def test_classifier_learns_from_informative_features() -> None:
    line = LateralLine(num_neuromasts=3, num_samples=INTERVAL, features=("t", "x"))
    place = make_settings(task=make_task(lateral_line=line), reads=("t", "x"), window=1)
    fits = [fit(each, make_episodes()) for each in (make_settings(window=INTERVAL), place)]
    assert fits[0].held_out.accuracy > 0.95
    assert fits[1].held_out.accuracy < 0.75


def test_program_writes_classifier_and_figures(tmp_path: Path) -> None:
    settings, task = make_settings(num_epochs=10, paper_epochs=3), make_task()
    fits = train_lateral_line(settings, make_episodes(), tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {
        *("lateral_line.json", "classifier.pt", "curves.png", "confusion.png")
    }
    findings, table = json.loads((tmp_path / "lateral_line.json").read_text()), tabulate(fits)
    assert findings["chance"] == 0.5
    for name in ("classifier", "paper"):
        assert f"{findings[name]['held_out_accuracy']:.1%}" in table
    classifier = LateralLineClassifier.load(tmp_path / "classifier.pt")
    classifier.check(flows=task.flow_labels, sensors=task.lateral_line_layout)
    assert classifier.features == list(LOCAL)
