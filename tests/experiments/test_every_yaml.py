"""Every YAML under conf/ is composed by its program and briefly run, on fish that glide."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from experiments import evaluate, train, train_lateral_line, view
from experiments.config import CONF, load_config
from tests.envs.conftest import SMALL, gliding  # noqa: F401 - a fixture

pytestmark = pytest.mark.usefixtures("gliding")

YAMLS = sorted(path.relative_to(CONF).as_posix() for path in CONF.rglob("*.yaml"))
TINY = [
    *(f"task.{name}={value}" for name, value in {**SMALL, "wall_margin_bl": 0.25}.items()),
    "compile=false",
    "num_envs=2",
]
BRIEF = [
    "task.time_limit=2",
    "total_frames=4",
    "warmup_frames=2",
    "batch_size=2",
    "hidden=[8]",
    "eval_frames=4",
    "eval_episodes=1",
    "final_episodes=1",
    "picture_episodes=0",
    "baselines=[]",
]


def run_training(folder: Path, *overrides: str) -> None:
    line = [*TINY, *BRIEF, f"folder={folder}", "name=run", *overrides]
    if overrides:
        train.train(load_config("train", line))
    else:
        sys.argv = ["train", *line]
        train.main()
    summary = json.loads((folder / "run" / "summary.json").read_text())
    assert (summary["frames"], summary["updates"] > 0) == (4, True)


def run_evaluation(folder: Path) -> None:
    saved = folder / "result.json"
    sys.argv = ["evaluate", *TINY, "policy=random", "episodes=2", f"save={saved}"]
    evaluate.main()
    assert json.loads(saved.read_text())["episodes"] == 2


def run_lateral_line(folder: Path) -> None:
    brief = ["num_samples=96", "max_decisions=4", "num_epochs=1", "paper_epochs=1", "num_splits=1"]
    brief += ["windows=[1]", "noises=[0.0]", "memories=[0.0]", "hidden=[4]"]
    brief += [f"folder={folder}", "name=run", f"data_folder={folder / 'data'}"]
    sys.argv = ["train_lateral_line", *TINY, *brief]
    train_lateral_line.main()
    assert (folder / "run" / "machine.pt").is_file()


def run_view(folder: Path) -> None:
    view.main(
        [*TINY[:-1], "policy=intercept", "episodes=1", "periods=1", f"save={folder / 'x.rrd'}"]
    )
    assert (folder / "x.rrd").is_file()


#: How a file is run: by its path or, for a group, by the group.
RUNS: dict[str, Callable[[Path, str], None]] = {
    "train.yaml": lambda folder, _: run_training(folder),
    "evaluate.yaml": lambda folder, _: run_evaluation(folder),
    "train_lateral_line.yaml": lambda folder, _: run_lateral_line(folder),
    "view.yaml": lambda folder, _: run_view(folder),
    "algorithm": lambda folder, name: run_training(
        folder, f"algorithm={name}", *(["algorithm.sequence_length=2"] if name == "drqn" else [])
    ),
    "preset": lambda folder, name: run_training(folder, f"preset={name}"),
    "task": lambda folder, name: run_training(folder, f"task={name}"),
    "logger": lambda folder, name: run_training(
        folder, f"logger={name}", *(["logger.is_offline=true"] if name == "wandb" else [])
    ),
}


@pytest.mark.parametrize("yaml", YAMLS)
def test_every_yaml_is_composed_and_runs(
    yaml: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "argv", [])  # put back afterwards
    monkeypatch.setenv("WANDB_SILENT", "true")
    key = yaml.split("/", 1)[0]
    assert key in RUNS, f"conf/{yaml}: say in RUNS how it is run"
    RUNS[key](tmp_path, Path(yaml).stem)


def test_there_are_yamls() -> None:
    assert {"train.yaml", "preset/small.yaml", "task/predation.yaml"} <= set(YAMLS)
