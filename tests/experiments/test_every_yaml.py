"""Every YAML under conf/ and every program that makes a task runs briefly, on kinematic fish."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from experiments import evaluate, train, train_lateral_line, view
from experiments.configuration import CONF
from tests.envs.conftest import SMALL, kinematic  # noqa: F401 - a fixture

pytestmark = pytest.mark.usefixtures("kinematic")

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
    train.main([*TINY, *BRIEF, f"folder={folder}", "name=run", *overrides])
    summary = json.loads((folder / "run" / "summary.json").read_text())
    assert (summary["frames"], summary["updates"] > 0) == (4, True)


#: What a choice needs besides.
MORE = {"drqn": ["algorithm.sequence_length=2"], "wandb": ["logger.is_offline=true"]}


@pytest.mark.parametrize("yaml", YAMLS)
def test_every_yaml_is_composed_and_runs(
    yaml: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("WANDB_SILENT", "true")
    group, _, file = yaml.partition("/")
    name = Path(file).stem
    run_training(tmp_path, f"{group}={name}", *MORE.get(name, []))


def test_a_policy_is_evaluated(tmp_path: Path) -> None:
    saved = tmp_path / "result.json"
    evaluate.main([*TINY, "policy=random", "episodes=2", f"save={saved}"])
    assert json.loads(saved.read_text())["episodes"] == 2


def test_a_lateral_line_is_trained(tmp_path: Path) -> None:
    brief = ["num_samples=96", "max_decisions=4", "num_epochs=1", "paper_epochs=1", "num_splits=1"]
    brief += ["windows=[1]", "noises=[0.0]", "memories=[0.0]", "hidden=[4]"]
    brief += [f"folder={tmp_path}", "name=run", f"data_folder={tmp_path / 'data'}"]
    train_lateral_line.main([*TINY, *brief])
    assert (tmp_path / "run" / "machine.pt").is_file()


def test_a_policy_is_shown(tmp_path: Path) -> None:
    view.main(
        [*TINY[:-1], "policy=intercept", "episodes=1", "periods=1", f"save={tmp_path / 'x.rrd'}"]
    )
    assert (tmp_path / "x.rrd").is_file()


def test_there_are_yamls() -> None:
    assert {"preset/small.yaml", "task/predation.yaml"} <= set(YAMLS)
