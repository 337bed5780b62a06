"""Links in folders of results: what they lead to is neither changed nor carried away."""

from __future__ import annotations

from itertools import cycle
from pathlib import Path
from shutil import copytree, rmtree

import pytest

from fishrl.programs.summarize import summarize
from fishrl.programs.sweeps.runs import read_run
from fishrl.training import Classifier, resume
from fishrl.training.export import export_policy
from fishrl.training.loop import Training

#: What trainings with other settings write, and what is there while one writes.
OTHERS = (
    *(
        "output.log",
        "failure.txt",
        ".lock",
        "episode.rrd",
        "classifier.pt",
        "wandb_id",
        "tensorboard",
    ),
    *("checkpoints/.last.new", "checkpoints/..last.new", "learning_curve.png"),
)
SUMMARY = ("summary.md", "summary.csv", "runs.csv", "curves.png")


def test_a_run_folder_with_a_link_that_leads_out_of_it_is_refused(
    whole: Training, tmp_path: Path
) -> None:
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "key").write_text("private")
    names = [path.relative_to(whole.folder.path) for path in whole.folder.path.rglob("*")]
    targets = cycle((outside / "new", outside, outside / "key"))
    for name, target in zip([*names, *map(Path, OTHERS)], targets, strict=False):
        run = copytree(whole.folder.path, tmp_path / "run")
        place = run / name
        rmtree(place) if place.is_dir() else place.unlink(missing_ok=True)
        place.symlink_to(target)
        for act in (
            lambda: resume(run, total_frames=480),  # noqa: B023 - called at once
            lambda: export_policy(run, tmp_path / "policy"),  # noqa: B023
            lambda: read_run(run),  # noqa: B023
        ):
            with pytest.raises(ValueError, match=r"link that leads out|no config\.yaml|damaged"):
                act()
        rmtree(run)
    assert [(path.name, path.read_text()) for path in outside.iterdir()] == [("key", "private")]
    assert not (tmp_path / "policy").exists()


def test_a_summary_replaces_links(whole: Training, tmp_path: Path) -> None:
    (tmp_path / "key").write_text("private")
    copytree(whole.folder.path, tmp_path / "sweep" / "run")
    for name in SUMMARY:
        (tmp_path / "sweep" / name).symlink_to(tmp_path / "key")
    summarize(tmp_path / "sweep")
    assert not any((tmp_path / "sweep" / name).is_symlink() for name in SUMMARY)
    assert (tmp_path / "key").read_text() == "private"


def test_only_a_classifier_is_kept_as_one(tmp_path: Path) -> None:
    key = tmp_path / "key"
    key.write_text("private")
    with pytest.raises(ValueError, match="cannot be read"):
        Classifier(path=str(key)).keep(tmp_path)
    assert not (tmp_path / "classifier.pt").exists()
