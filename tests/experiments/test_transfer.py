"""Comparison of policies in every stream, with kinematic fish."""

from pathlib import Path

import pytest

from experiments import transfer as program
from experiments.gait.trials import make_trial
from experiments.transfer import TransferSettings, transfer
from fishrl.envs.control import DirectFrequencies
from fishrl.envs.streams import Stream
from tests.experiments.gait.tasks import BRIEF, make_task

pytestmark = pytest.mark.usefixtures("kinematic")


def test_repeated_names_and_different_tasks_are_refused(tmp_path: Path) -> None:
    settings = TransferSettings(task=make_task(), episodes=1, folder=str(tmp_path))
    pid = make_trial("pid", make_task(), periods=BRIEF)
    with pytest.raises(ValueError, match="policy names must be unique"):
        transfer([pid, pid], settings)
    other = make_trial("bang_bang", make_task(reynolds=400.0), periods=BRIEF)
    with pytest.raises(ValueError, match="tasks differ in reynolds"):
        transfer([pid, other], settings)
    stream = Stream(speeds_bl=(1.0, 1.0), diameter_bl=(0.4, 0.5))
    control = DirectFrequencies(frequencies=(0.5, 1.0))
    task = make_task(stream=stream, control=control, start_flows=(0,))
    several = make_trial("bang_bang", task, periods=BRIEF)
    with pytest.raises(ValueError, match="several half discs"):
        transfer([several], settings)


def test_task_of_runs_cannot_be_changed(tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match="the runs bring their own"):
        program.main(["runs=[zoo/gait_sharp]", "task.reynolds=900", f"folder={tmp_path}"])


def test_work_is_compared_with_free_stream(tmp_path: Path) -> None:
    settings = TransferSettings(
        task=make_task(), episodes=2, periods=4.0, free_episodes=1, folder=str(tmp_path)
    )
    results = transfer([make_trial("pid", make_task(), periods=4.0)], settings)
    free = results["free_stream"]
    assert [(flow["held"], flow["episodes"]) for flow in free["flows"]] == [(1, 1)] * 3
    assert [len(flow["work"]) for flow in free["work"]] == [5, 5, 5]  # at 0 to 4 T
    page = (tmp_path / "transfer.md").read_text(encoding="utf-8")
    assert "| stream, L/T | muscles, wake | free | ratio |" in page
    assert f"T = {free['steps_per_T']} steps" in page
