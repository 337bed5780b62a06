"""Algorithms and loggers under conf/ train briefly, on kinematic fish; others are composed.

Every task is trained by ``tests/smoke``.
"""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from fishrl.envs import make_task
from fishrl.programs import train
from fishrl.programs.configuration import CONF
from fishrl.programs.train_settings import TRAINING
from tests.experiments.gait.tasks import OVERRIDES
from tests.smoke.test_programs import FEW

pytestmark = pytest.mark.usefixtures("kinematic")

CHOICES = TRAINING.list_choices()

YAMLS = sorted(
    path.relative_to(CONF).as_posix()
    for group in TRAINING.groups
    if group not in ("preset", "task")
    for path in (CONF / group).glob("*.yaml")
)
TINY = [*OVERRIDES, *FEW, "picture_episodes=0", "baselines=[]", "name=run"]
#: What a choice needs besides.
MORE = {
    "drqn": ["algorithm.sequence_length=2"],
    "ppo": ["algorithm.rollout_length=2"],
    "sac": ["task=predation_continuous"],
    # continuous actions
    "follower": ["algorithm=sac"],
    "follower-v1": ["algorithm=sac"],
    "karman_gait_continuous": ["algorithm=sac"],
    "predation_continuous": ["algorithm=sac"],
}


@pytest.mark.parametrize(
    ("group", "name"),
    [
        (group, name)
        for group in ("preset", "task")
        for name in CHOICES[group]
        if "-quick-v" not in name  # made by tests/benchmark
    ],
)
def test_every_preset_and_task_has_a_valid_flow_also_on_levels(group: str, name: str) -> None:
    settings = TRAINING.read([f"{group}={name}", *MORE.get(name, [])])
    assert settings.preset == (name if group == "preset" else None)
    assert make_task(name) == settings.task
    refined = make_task(name, levels=2)
    assert refined == replace(settings.task, levels=2)
    for task in (settings.task, refined):
        task.flow_config()  # refuses what cannot be simulated


@pytest.mark.parametrize("yaml", YAMLS)
def test_every_yaml_runs(yaml: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WANDB_MODE", "disabled")
    group, _, file = yaml.partition("/")
    name = Path(file).stem
    words = [*TINY, f"folder={tmp_path}", f"{group}={name}", *MORE.get(name, [])]
    train.main.run(train.main.read(words))
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert (summary["frames"], summary["updates"] > 0) == (4, True)
