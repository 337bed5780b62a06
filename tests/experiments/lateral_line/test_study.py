"""The study of a lateral line: fits, questions, results and files."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import pytest
import torch

from experiments.lateral_line.questions import answer, predict
from experiments.lateral_line.report import format_accuracies
from experiments.lateral_line.study import (
    Split,
    TrainingData,
    split_by_row,
    split_by_start,
    split_by_time,
)
from experiments.train_lateral_line import LateralLineSettings, main, study_lateral_line
from fishrl.envs.lateral_line import LOCAL
from fishrl.modules import LateralLineClassifier
from fishrl.objectives import FitSettings
from fishrl.training.progress import Progress
from tests.experiments.lateral_line.signals import INTERVAL, make_episodes, make_study, make_task


def test_a_classifier_learns_what_tells_the_flows_apart() -> None:
    fit = make_study().fit(TrainingData(features=LOCAL, num_samples=INTERVAL))
    assert fit.held_out.accuracy > 0.95
    uninformed = TrainingData(features=("t", "x"), num_samples=1)
    assert make_study().fit(uninformed).held_out.accuracy < 0.75


def test_memory_sums_the_evidence_of_the_episode_so_far() -> None:
    fit = make_study().fit(TrainingData(features=("t", "ahead"), num_samples=1))
    logits = fit.classifier(fit.test["lateral_line"]).log_softmax(-1)
    expected = []
    for episode in fit.test["episode"].unique():
        evidence = torch.zeros(2)
        for row in (fit.test["episode"] == episode).nonzero().squeeze(-1):
            evidence = 0.5 * evidence + logits[row]
            expected.append(int(evidence.argmax()) == int(fit.test["flow_index"][row]))
    assert predict(fit, memory=0.5).tolist() == expected
    assert torch.equal(predict(fit), logits.argmax(-1) == fit.test["flow_index"])


@pytest.mark.parametrize("split", [split_by_start, split_by_time])
def test_new_starts_and_times_share_no_episode_with_the_fit(split: Split) -> None:
    study = make_study()
    data = study.cut(TrainingData(features=LOCAL, num_samples=1))
    *known, new = split(study, data, 0)
    fitted = known[0] | known[1]
    assert new.any() and fitted.any()
    assert not set(data["episode"][new].tolist()) & set(data["episode"][fitted].tolist())
    if split is split_by_start:
        assert data["start"][new, 0].min() > data["start"][fitted, 0].max()
    else:
        assert data["decision"][new].min() > data["decision"][fitted].max()


def test_fits_on_the_right_row_and_on_any_get_as_many_samples() -> None:
    study = make_study()
    data = study.cut(TrainingData(features=LOCAL, num_samples=1))
    right, as_many = (
        partial(split_by_row, is_right_only=is_right_only)(study, data, 0)
        for is_right_only in (True, False)
    )
    assert [int(mask.sum()) for mask in right] == [int(mask.sum()) for mask in as_many]
    assert (data["named_flow"] == data["flow_index"])[right[0]].all()


def test_equal_fits_are_made_once() -> None:
    study, made = make_study(), []

    class Counting(type(study)):  # type: ignore[misc]
        def fit(self, *arguments: object, **options: object) -> object:
            made.append(options)
            return super().fit(*arguments, **options)

    brief = FitSettings(num_epochs=1)
    tables = answer(
        Counting(**vars(study) | {"settings": brief}), window=2, windows=[2], noises=[0.0],
        memories=[0.0, 1.0], num_splits=2, progress=Progress(is_shown=False),
    )  # fmt: skip
    # 7 inputs, divided in 3 ways, and 2 rows; those of the longest window are among the inputs
    assert len(made) == 2 * (7 * 3 + 2)
    assert {name: list(table) for name, table in tables.items()} == {
        "memory": ["accuracy"],
        "by_decision": ["0", "1"],
        "windows": ["accuracy"],
        "noise": ["fitted without noise", "fitted with this noise"],
        "leaks": ["fitted", "new episodes", "new starts", "later times"],
        "rows": ["in the right row", "in a wrong row"],
    }
    assert len(tables["memory"]["accuracy"]["1"]) == 2


def test_a_study_writes_page_numbers_figures_and_a_classifier_that_the_task_takes(
    tmp_path: Path,
) -> None:
    settings = LateralLineSettings(
        num_splits=1, num_epochs=10, paper_epochs=3, hidden=(8,), windows=(1, 5), noises=(0.0, 1.0),
        learning_rate=0.01,
    )  # fmt: skip
    task = make_task()
    findings = study_lateral_line(
        settings,
        task=task,
        episodes=make_episodes(),
        folder=tmp_path,
        progress=Progress(is_shown=False),
    )
    names = {"lateral_line.md", "lateral_line.json", "machine.pt"}
    assert names | {"curves.png", "confusion.png", "limits.png"} == {
        path.name for path in tmp_path.iterdir()
    }
    assert json.loads((tmp_path / "lateral_line.json").read_text())["chance"] == 0.5
    assert findings["leaks"]["new episodes"]["local: instant, each neuromast"][0] > 0.9
    page = (tmp_path / "lateral_line.md").read_text(encoding="utf-8")
    assert f"{findings['classifier']['held_out_accuracy']:.1%}" in page
    classifier = LateralLineClassifier.load(tmp_path / "machine.pt")
    classifier.check(flows=task.flow_labels, sensors=task.lateral_line_layout)
    assert classifier.features == list(LOCAL)


def test_accuracies_are_written_with_their_range() -> None:
    assert format_accuracies([0.9, 0.8]) == "85.0% [80.0-90.0]"
    assert format_accuracies([0.5]) == "50.0%"
    assert format_accuracies([float("nan")]) == "-"


@pytest.mark.parametrize("argument", ["num_samples=0", "windows=[0]", "window=x"])
def test_settings_out_of_range_are_refused(argument: str) -> None:
    assert main.read([]).num_samples == 6000
    with pytest.raises(ValueError, match=argument.split("=")[0]):
        main.read([argument])
