"""Transitions written as a dataset are read back by Minari."""

from pathlib import Path

import minari
import numpy as np
import pytest

from fishrl.programs import export_data
from fishrl.training.progress import Progress
from tests.programs.test_export import TINY


@pytest.mark.usefixtures("kinematic")
def test_minari_reads_the_transitions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    tiny = [words for words in TINY if not words.startswith(("periods", "frames_per_T"))]
    settings = export_data.main.read(
        [*tiny, "name=fishrl/pursuit-v0", "episodes=3", "num_envs=2", f"folder={tmp_path}",
         "task.time_limit=4"]
    )  # fmt: skip
    export_data.record(settings, progress=Progress(is_shown=False))
    with pytest.raises(ValueError, match="exists: take the next version"):
        export_data.record(settings, progress=Progress(is_shown=False))
    data = minari.load_dataset("fishrl/pursuit-v0")
    episodes = list(data.iterate_episodes())
    assert len(episodes) == 3
    for episode in episodes:
        num = len(episode.actions)
        assert 1 <= num <= 4 and data.observation_space["observation"].dtype == np.float32
        assert len(episode.observations["observation"]) == len(episode.infos["captured"]) == num + 1
        masks = episode.observations["action_mask"][:-1]
        assert masks[np.arange(num), episode.actions].all()  # only legal actions
        over = episode.terminations | episode.truncations
        assert over[-1] and not over[:-1].any()


@pytest.mark.usefixtures("kinematic")
def test_a_seed_repeats_the_sampled_actions(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    sampled = []
    for name in ("first-v0", "second-v0"):
        settings = export_data.main.read(
            [f"name={name}", f"folder={tmp_path}", "policy=zoo/predation_small", "episodes=2",
             "samples_actions=true", "compile=false", "task.time_limit=12"]
        )  # fmt: skip
        data = export_data.record(settings, progress=Progress(is_shown=False))
        sampled.append([episode.actions.tolist() for episode in data.iterate_episodes()])
    assert sampled[0] == sampled[1]
