"""Fits of lateral-line classifiers: what they learn, and what is written."""

from __future__ import annotations

import json
from pathlib import Path

from fishrl.envs.lateral_line import LOCAL, LateralLine
from fishrl.modules import LateralLineClassifier
from fishrl.programs.lateral_line.fitting import fit
from fishrl.programs.lateral_line.report import tabulate
from fishrl.programs.train_lateral_line import train_lateral_line
from fishrl.training.progress import Progress
from tests.programs.lateral_line.signals import INTERVAL, make_episodes, make_settings, make_task

QUIET = Progress(is_shown=False)


def test_classifier_learns_the_difference_between_flows_from_informative_features() -> None:
    line = LateralLine(num_neuromasts=3, num_samples=INTERVAL, features=("t", "x"))
    place = make_settings(task=make_task(lateral_line=line), reads=("t", "x"), window=1)
    fits = [fit(each, make_episodes()) for each in (make_settings(window=INTERVAL), place)]
    assert fits[0].held_out.accuracy > 0.95
    assert fits[1].held_out.accuracy < 0.75


def test_program_writes_numbers_figures_and_a_classifier_that_the_task_takes(
    tmp_path: Path,
) -> None:
    settings, task = make_settings(num_epochs=10, paper_epochs=3), make_task()
    fits = train_lateral_line(settings, make_episodes(), tmp_path, QUIET)
    assert {path.name for path in tmp_path.iterdir()} == {
        *("lateral_line.json", "machine.pt", "curves.png", "confusion.png")
    }
    findings, table = json.loads((tmp_path / "lateral_line.json").read_text()), tabulate(fits)
    assert findings["chance"] == 0.5
    for name in ("classifier", "paper"):
        assert f"{findings[name]['held_out_accuracy']:.1%}" in table
    classifier = LateralLineClassifier.load(tmp_path / "machine.pt")
    classifier.check(flows=task.flow_labels, sensors=task.lateral_line_layout)
    assert classifier.features == list(LOCAL)
