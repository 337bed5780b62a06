"""The search with Optuna, on kinematic fish."""

from pathlib import Path
from typing import Any

import pytest

from fishrl.envs import Flows, Predation
from fishrl.training.run_folder import RunFolder
from tests.envs.conftest import SMALL

optuna = pytest.importorskip("optuna", reason="pip install -e '.[sweep]'")
pytestmark = [pytest.mark.usefixtures("kinematic"), pytest.mark.sweep]

FEW: dict[str, Any] = {"total_frames": 8, "eval_frames": 8, "eval_episodes": 1, "baselines": ()}


def test_killed_search_continues_its_trial(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from examples import search

    def go(trials: int) -> Any:
        few = FEW | {"final_episodes": 1, "flows": Flows(num_envs=2, compile=False)}
        task = Predation(**SMALL, time_limit=3)
        return search.search(task, tmp_path, trials=trials, metric="mean_length_T", **few)

    def die(**_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(search, "train", die)
        with pytest.raises(KeyboardInterrupt):
            go(2)
    study = go(2)
    assert [trial.state.name for trial in study.trials] == ["COMPLETE"] * 2
    assert all(RunFolder(tmp_path / f"trial_{number}").summary.is_file() for number in (0, 1))
    assert len(go(2).trials) == 2
