"""A run is checked before anything slow: no compile, no wakes, no folder."""

from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import pytest
import torch

from fishrl.envs import Flows, KarmanGait, Oracle, Predation, make_env
from fishrl.envs.control import Bend
from fishrl.envs.streams import Stream
from fishrl.physics import InPlaceSolver
from fishrl.programs.sweeps.runs import advise, read_run
from fishrl.training import Plan, complete, open_run
from fishrl.training.algorithms.dqn import DQN
from fishrl.training.algorithms.drqn import DRQN
from fishrl.training.checkpoint import save_checkpoint
from fishrl.training.loop import Training
from fishrl.training.policy_spec import PolicySpec
from fishrl.training.run_folder import HeldError, RunFolder
from tests.envs.conftest import SMALL
from tests.training.conftest import QUICK, Toy, make_run_folder, make_toy_plan


def test_baseline_with_wakes_is_checked_without_developing_them(tmp_path: Path) -> None:
    task = KarmanGait(stream=Stream(wake_folder=str(tmp_path / "wakes")))
    resolved = open_run(Plan(task=task, baselines=("shedding",), recognition=Oracle()))
    assert resolved.baselines == ("shedding",)
    assert resolved.task == task.read_flow_labels() and resolved.task != task
    assert not list(tmp_path.iterdir())


def test_wrong_observation_size_is_refused_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    class Wrong(Predation):
        n_obs: ClassVar[int] = 5

    monkeypatch.setattr(InPlaceSolver, "compile", lambda *_, **__: pytest.fail("compiled"))
    with pytest.raises(ValueError, match=r"Wrong.observe gives .*\(1, 4\).* shape \(1, 5\)"):
        make_env(task=Wrong(**SMALL), flows=Flows(num_envs=1))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"baselines": ("randm",)}, "did you mean 'random'"),
        ({"flows": Flows(device="cuda:99")}, "CUDA devices"),
        ({"name": ""}, "name = '': must be a name without slashes"),
        ({"scale_inputs": True, "warmup_frames": 0}, "warmup_frames = 0: .* raise it"),
        ({"initial_policy": "nowhere"}, "checkpoint nowhere: there is none"),
        ({"buffer_size": 10**12}, "buffer .* GB: more than the .* GB of cpu"),
    ],
)
def test_invalid_settings_leave_no_folder(toy: Toy, wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        toy.begin(**wrong)
    assert not list(toy.folder.iterdir())


def test_folder_that_cannot_be_written_is_named_before_anything_is_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A folder stands where the run has its lock."""
    monkeypatch.setattr(Training, "_set_up", lambda _: pytest.fail("set up"))
    (tmp_path / "runs" / "run" / ".lock").mkdir(parents=True)
    opened = open_run(make_toy_plan(tmp_path / "runs", name="run"))
    with pytest.raises(ValueError, match=r"folder .*runs.*run: cannot be written .*folder=\.\.\."):
        Training(opened)


def test_labels_lengthen_the_observation_of_the_policy() -> None:
    task = KarmanGait(observes=("place", "flow_label"))
    without, with_labels = (
        open_run(Plan(task=task, recognition=choice)) for choice in (None, Oracle())
    )
    num_flows = len(task.flow_labels)
    assert with_labels.spec.num_observed == without.spec.num_observed + num_flows


def test_initial_policy_of_other_senses_is_refused(tmp_path: Path) -> None:
    observed = ("place", "drift"), ("water_velocity", "place"), ("drift", "place")
    first, *others = (Plan(task=KarmanGait(observes=names)) for names in observed)
    spec = PolicySpec.for_task(first.task)
    actor = {"actor": first.algorithm.make_policy(spec)}
    save_checkpoint(tmp_path / "first", actor, spec=spec, frames=1, config=first.to_config())
    for plan in others:
        opened = open_run(replace(plan, initial_policy=str(tmp_path / "first")))
        with pytest.raises(ValueError, match=r"senses = .*: the policy"):
            opened.check()


def test_labels_that_nobody_reads_are_named(caplog: pytest.LogCaptureFixture) -> None:
    for observed in (("place",), ("place", "flow_label")):
        task = KarmanGait(observes=observed, control=Bend())
        open_run(Plan(task=task, recognition=Oracle())).check()
    said = [each.getMessage() for each in caplog.records]
    assert ["does not observe flow_label" in words for words in said] == [True]


def test_states_of_a_recurrent_policy_count_in_memory(tmp_path: Path) -> None:
    given = {"hidden": (256,), "buffer_size": 1000}
    plain, recurrent = (
        open_run(make_toy_plan(tmp_path, algorithm=kind, **given)).count_bytes()["cpu"]["buffer"]
        for kind in (DQN(), DRQN())
    )
    assert recurrent - plain == 4 * 1000 * 2 * 256


@pytest.mark.parametrize("seen", ["nothing", "nothing, other gamma", "folder", "checkpoint"])
@pytest.mark.parametrize("done", ["begun", "saved", "finished"])
def test_run_that_another_process_has_gone_on_with_since_it_was_read_is_left_alone(
    toy: Toy, seen: str, done: str
) -> None:
    """One run is opened, the other one with its name goes on, then the first would begin."""
    settings: dict[str, Any] = QUICK | {"name": "run"}
    changed = {"gamma": 0.5} if "other gamma" in seen else {}
    if seen == "checkpoint":
        complete(toy.begin(**settings, total_frames=80))
    elif seen == "folder":
        make_run_folder(make_toy_plan(toy.folder, **settings))
    late = open_run(make_toy_plan(toy.folder, **settings | changed, total_frames=240))
    frames = {"begun": 88, "saved": 160, "finished": 240}[done]
    other = toy.begin(**settings, total_frames=frames)
    if done != "begun":
        complete(other)
    other.close()
    before = other.folder.config.read_text(), other.folder.metrics.exists()
    is_unchanged = done == "begun" and "nothing" not in seen
    with nullcontext() if is_unchanged else pytest.raises(HeldError, match="repeat the command"):
        Training(late).close()
    if not is_unchanged:
        assert before == (other.folder.config.read_text(), other.folder.metrics.exists())
        assert [path.name for path in toy.folder.iterdir()] == ["run"]


def fail(*_: Any, **__: Any) -> None:
    torch.manual_seed(7)
    raise RuntimeError("no compiler")


def test_failed_extension_leaves_run_lock_and_generators_alone(
    toy: Toy, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = toy.begin(name="run", total_frames=16, **QUICK)
    complete(first)
    files, generator = (first.folder.config, first.folder.summary), torch.get_rng_state()
    before = [file.read_text() for file in files]
    monkeypatch.setattr("fishrl.training.loop.make_collector", fail)
    with pytest.raises(RuntimeError, match="no compiler") as kept:
        Training(open_run(first.folder.path, final_episodes=4))
    monkeypatch.undo()
    assert before == [file.read_text() for file in files]
    assert torch.equal(generator, torch.get_rng_state())
    Training(open_run(first.folder.path, final_episodes=4)).close()
    assert kept.tb is not None  # with its local variables, as in a notebook


def test_named_run_that_failed_before_its_first_frame_takes_new_settings(
    toy: Toy, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fishrl.training.loop.make_collector", fail)
    with pytest.raises(RuntimeError, match="no compiler"):
        toy.begin(name="run", gamma=0.9)
    monkeypatch.undo()
    toy.begin(name="run", gamma=0.5, total_frames=16, **QUICK).run()
    assert open_run(toy.folder / "run").plan.gamma == 0.5
    (toy.folder / "run" / "failure.txt").touch()
    with pytest.raises(ValueError, match=r"gamma = 0\.9: is 0\.5 in"):
        toy.begin(name="run", gamma=0.9)


def test_error_is_raised_though_it_cannot_be_noted(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path / "nowhere")
    with pytest.raises(ChildProcessError, match="a flow worker"), folder.noting_failure():
        raise ChildProcessError("a flow worker failed")


def test_one_process_trains_a_run_once(toy: Toy) -> None:
    first = toy.begin(**QUICK, name="run")
    assert "rerun" not in advise([read_run(first.folder.path)])
    for _ in range(2):  # a look at the run lets nobody in
        assert read_run(first.folder.path).status == "running"
        with pytest.raises(HeldError, match="another training writes it"):
            Training(open_run(first.folder.path))
    first.close()
    toy.reopen("run").close()
