"""The study of a lateral line: fits, questions, results and files."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import pytest
import torch

from fishrl.envs.lateral_line import LOCAL
from fishrl.modules import LateralLineClassifier
from fishrl.programs.lateral_line.report import format_accuracies
from fishrl.programs.lateral_line.study import (
    Question,
    Split,
    Study,
    split_by_row,
    split_by_start,
    split_by_time,
)
from fishrl.programs.train_lateral_line import study_lateral_line
from fishrl.training.progress import Progress
from tests.programs.lateral_line.signals import INTERVAL, make_study, make_task

QUIET = Progress(is_shown=False)


def test_a_classifier_learns_what_tells_the_flows_apart() -> None:
    study = make_study()
    assert study.fit(Question(features=LOCAL, num_samples=INTERVAL)).held_out.accuracy > 0.95
    assert study.fit(Question(features=("t", "x"))).held_out.accuracy < 0.75


def test_memory_sums_the_evidence_of_the_episode_so_far() -> None:
    fit = make_study().fit(Question(features=("t", "ahead")))
    logits = fit.classifier(fit.test["lateral_line"]).log_softmax(-1)
    expected = []
    for episode in fit.test["episode"].unique():
        evidence = torch.zeros(2)
        for row in (fit.test["episode"] == episode).nonzero().squeeze(-1):
            evidence = 0.5 * evidence + logits[row]
            expected.append(int(evidence.argmax()) == int(fit.test["flow_index"][row]))
    assert fit.predict(memory=0.5).tolist() == expected
    assert torch.equal(fit.predict(), logits.argmax(-1) == fit.test["flow_index"])


@pytest.mark.parametrize("split", [split_by_start, split_by_time])
def test_new_starts_and_times_share_no_episode_with_the_fit(split: Split) -> None:
    study = make_study()
    data = study.cut(Question(features=LOCAL))
    *known, new = split(data, study.episodes, 0)
    fitted = known[0] | known[1]
    assert new.any() and fitted.any()
    assert not set(data["episode"][new].tolist()) & set(data["episode"][fitted].tolist())
    key = data["start"][:, 0] if split is split_by_start else data["decision"]
    assert key[new].min() > key[fitted].max()


def test_fits_on_the_right_row_and_on_any_get_as_many_samples() -> None:
    study = make_study()
    data = study.cut(Question(features=LOCAL))
    split = partial(split_by_row, data, study.episodes, 0)
    right, as_many = (split(is_right_only=is_right_only) for is_right_only in (True, False))
    assert [int(mask.sum()) for mask in right] == [int(mask.sum()) for mask in as_many]
    assert (data["named_flow"] == data["flow_index"])[right[0]].all()


def test_equal_fits_are_made_once(monkeypatch: pytest.MonkeyPatch) -> None:
    made, fit = [], Study.fit

    def count(study: Study, question: Question, **options: int) -> object:
        made.append(question)
        return fit(study, question, **options)

    monkeypatch.setattr(Study, "fit", count)
    few = {"window": 2, "windows": (2,), "noises": (0.0,), "memories": (0.0, 1.0)}
    tables = make_study(num_epochs=1, num_splits=2, **few).answer(QUIET)
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
    few = {"num_epochs": 10, "paper_epochs": 3, "windows": (1, 5), "noises": (0.0, 1.0)}
    study, task = make_study(num_splits=1, **few), make_task()
    findings = study_lateral_line(study.settings, study.episodes, tmp_path, QUIET)
    pictures = {"curves.png", "confusion.png", "limits.png"}
    assert {"lateral_line.md", "lateral_line.json", "machine.pt"} | pictures == {
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
    values = ([0.9, 0.8], [0.5], [float("nan")])
    assert [*map(format_accuracies, values)] == ["85.0% [80.0-90.0]", "50.0%", "-"]
