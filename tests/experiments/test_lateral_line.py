"""The study of a lateral line: data that are kept, fits, findings, files."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from tensordict import TensorDict

import experiments.lateral_line.collection
from experiments.config import load_config
from experiments.lateral_line.collection import Collection, collect
from experiments.lateral_line.examination import examine
from experiments.lateral_line.findings import find_confirmation, find_leaks, name_flows
from experiments.lateral_line.report import format_accuracies
from experiments.lateral_line.study import Diet, Study, split_by_start, split_by_time
from experiments.settings import ConfigError, LateralLineConfig
from fishrl.envs import Predation, make_env, make_recognition
from fishrl.envs.lateral_line import KNOWN, LOCAL, LateralLine
from fishrl.envs.macro_actions import FrequencyBank, MacroActions
from fishrl.envs.stations import SafeArea
from fishrl.envs.streams import Stream
from fishrl.envs.tasks import KarmanGait
from fishrl.modules import LateralLineClassifier
from fishrl.objectives import FitSettings
from fishrl.training.progress import Progress

INTERVAL = 4


def make_task(*, speeds: tuple[float, ...] = (1.0, 1.5), **changes: Any) -> KarmanGait:
    """Return a free stream in two speeds, the smallest there is."""
    arguments: dict[str, Any] = {
        "body_length": 20,
        "domain_bl": (6.0, 3.0),
        "stream": Stream(speeds_bl=speeds, has_disc=False),
        "start_flows": (0, 1),
        "control": MacroActions(bank=FrequencyBank(rows=((0.5, 1.0, 1.5), (1.0, 1.25, 1.5)))),
        "start_x_bl": (1.0, 1.2),
        "safe_area": SafeArea(far_bl=2.5),
        "lateral_line": LateralLine(num_neuromasts=3, num_samples=INTERVAL),
    }
    return KarmanGait(**(arguments | changes))


def make_episodes(num: int = 40, length: int = 5) -> TensorDict:
    """Return episodes with a sine of one frequency per flow in "ahead", and noise elsewhere."""
    generator = torch.Generator().manual_seed(0)
    flow = torch.arange(num) % 2
    signal = torch.randn(num, length, INTERVAL, 3, len(KNOWN), generator=generator)
    time = torch.arange(length * INTERVAL) / INTERVAL
    phase = 6.3 * torch.rand(num, generator=generator)
    sine = (6.3 * (0.25 + 0.25 * flow[:, None]) * time + phase[:, None]).sin()
    sine = sine.view(num, length, INTERVAL, 1)
    signal[..., KNOWN.index("ahead")] = 1.0 + 0.5 * flow.view(-1, 1, 1, 1) + 0.2 * sine
    start = torch.rand(num, 2, generator=generator)
    here = {
        "flow_index": flow,
        "named_flow": torch.randint(2, (num,), generator=generator),
        "episode": torch.arange(num),
    }
    is_decision = torch.arange(length) < torch.randint(2, length + 1, (num, 1), generator=generator)
    return TensorDict(
        {
            "lateral_line": signal,
            "is_decision": is_decision,
            "frequency": torch.ones(num, length),
            "start": start[:, None].expand(-1, length, -1).clone(),
            **{name: value[:, None].expand(-1, length).clone() for name, value in here.items()},
        },
        [num, length],
    )


def make_study() -> Study:
    task = Collection(task=make_task()).task
    return Study(
        episodes=make_episodes(),
        flows=task.flow_labels,
        layout=task.lateral_line_layout,
        hidden=(8,),
        settings=FitSettings(num_epochs=15, learning_rate=0.01),
    )


@pytest.fixture(scope="module")
def collected(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, TensorDict]:
    folder = tmp_path_factory.mktemp("data")
    collection = Collection(task=make_task(), num_envs=2, max_decisions=2)
    return folder, collect(collection, num_samples=5, folder=folder, compile=False)


def test_collected_episodes_hold_every_feature_with_the_true_flow(
    collected: tuple[Path, TensorDict],
) -> None:
    _, episodes = collected
    assert episodes.shape == (4, 2)
    assert episodes["lateral_line"].shape == (4, 2, INTERVAL, 3, len(KNOWN))
    assert episodes["lateral_line"].isfinite().all()
    assert episodes["is_decision"][:, 0].all()
    assert episodes["flow_index"][:, 0].tolist() == [0, 1, 0, 1]
    speed = episodes["lateral_line"][:, 0, 0, 0, KNOWN.index("u_x")]
    assert speed[1] > 1.2 * speed[0] > 0.0


def test_fish_hold_stations_and_act_at_random_in_rows_of_any_flow(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def collect_share(share: float) -> TensorDict:
        monkeypatch.setattr(experiments.lateral_line.collection, "RANDOM_SHARE", share)
        collection = Collection(task=make_task(), num_envs=6, max_decisions=3)
        return collect(collection, num_samples=1, folder=tmp_path / str(share), compile=False)

    drawn, holding = collect_share(1.0), collect_share(0.0)
    assert (drawn["named_flow"] == holding["named_flow"]).all()
    assert (drawn["named_flow"] != drawn["flow_index"]).any()
    # swept back at once, all wish to accelerate but those whose station is nearly out of reach
    assert holding["frequency"][:, 2].mean() > drawn["frequency"][:, 2].mean()
    rows = torch.tensor(((0.5, 1.0, 1.5), (1.0, 1.25, 1.5)))
    for episodes in (drawn, holding):
        row = rows[episodes["named_flow"][:, 1:]]
        assert (row == episodes["frequency"][:, 1:, None]).any(-1).all()


def test_what_was_collected_is_not_run_again(
    collected: tuple[Path, TensorDict], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, episodes = collected
    monkeypatch.setattr(experiments.lateral_line.collection, "FlowEnv", None)
    collection = Collection(task=make_task(), num_envs=2, max_decisions=2)
    assert (collect(collection, num_samples=5, folder=folder) == episodes).all()


def test_an_interrupted_collection_goes_on_as_if_nothing_had_been(
    collected: tuple[Path, TensorDict], tmp_path: Path
) -> None:
    folder, episodes = collected
    collection = Collection(task=make_task(), num_envs=2, max_decisions=2)
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    (tmp_path / collection.key / "piece-0001.pt").unlink()
    resumed = collect(collection, num_samples=5, folder=tmp_path, compile=False)
    assert (resumed == episodes).all()


def test_other_sensors_share_the_data_and_other_flows_and_seeds_do_not() -> None:
    key = Collection(task=make_task()).key
    noisy = make_task(lateral_line=LateralLine(num_neuromasts=3, num_samples=INTERVAL, noise=0.1))
    assert Collection(task=noisy).key == key
    assert Collection(task=make_task(reads_flow_class=True)).key == key
    assert Collection(task=make_task(speeds=(1.0, 1.4))).key != key
    assert Collection(task=make_task(), seed=1).key != key
    assert Collection(task=make_task(), max_decisions=3).key != key


def test_a_broken_piece_is_named(tmp_path: Path) -> None:
    collection = Collection(task=make_task())
    place = tmp_path / collection.key
    place.mkdir()
    (place / "piece-0000.pt").write_text("cut short")
    with pytest.raises(ValueError, match=r"piece-0000.pt: cannot be read .* delete the file"):
        collect(collection, num_samples=1, folder=tmp_path)


def test_a_task_without_two_flows_is_refused() -> None:
    with pytest.raises(ValueError, match="Predation has no two flows to tell apart"):
        Collection(task=Predation())


def test_a_machine_learns_what_tells_the_flows_apart() -> None:
    fit = make_study().fit(Diet(features=LOCAL, num_samples=INTERVAL))
    assert fit.held_out.accuracy > 0.95
    assert make_study().fit(Diet(features=("t", "x"), num_samples=1)).held_out.accuracy < 0.75


def test_memory_adds_up_what_was_said_in_the_episode_so_far() -> None:
    fit = make_study().fit(Diet(features=("t", "ahead"), num_samples=1))
    said = fit.machine(fit.test["lateral_line"]).log_softmax(-1)
    expected = []
    for episode in fit.test["episode"].unique():
        evidence = torch.zeros(2)
        for row in (fit.test["episode"] == episode).nonzero().squeeze(-1):
            evidence = 0.5 * evidence + said[row]
            expected.append(int(evidence.argmax()) == int(fit.test["flow_index"][row]))
    assert name_flows(fit, memory=0.5).tolist() == expected
    assert torch.equal(name_flows(fit), said.argmax(-1) == fit.test["flow_index"])


@pytest.mark.parametrize("make_split", [split_by_start, split_by_time])
def test_new_starts_and_times_share_no_episode_with_the_fit(
    make_split: Callable[..., Any],
) -> None:
    study = make_study()
    data = study.cut(Diet(features=LOCAL, num_samples=1))
    *known, new = make_split(study)(data)
    fitted = known[0] | known[1]
    assert new.any() and fitted.any()
    assert not set(data["episode"][new].tolist()) & set(data["episode"][fitted].tolist())
    if make_split is split_by_start:
        assert data["start"][new, 0].min() > data["start"][fitted, 0].max()
    else:
        assert data["decision"][new].min() > data["decision"][fitted].max()


def test_fits_on_the_right_row_and_on_any_get_as_many_samples() -> None:
    study, sizes = make_study(), []
    kept = Study.fit

    def fit(self: Study, diet: Diet, **arguments: Any) -> Any:
        data = self.cut(diet)
        sizes.append([int(mask.sum()) for mask in arguments["split"](data)])
        return kept(self, diet, **arguments)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Study, "fit", fit)
        answers = find_confirmation(
            study, Diet(features=LOCAL, num_samples=1), num_splits=1, on_fit=lambda: None
        )
    assert sizes[0] == sizes[1]
    assert len(answers) == 2


def test_leaks_are_sought_in_every_diet_and_kind_of_new_data() -> None:
    answers = find_leaks(make_study(), window=INTERVAL, num_splits=1, on_fit=lambda: None)
    assert answers["local: whole window, each neuromast"]["new episodes"][0] > 0.9
    assert all(len(found) == 4 for found in answers.values())


def test_a_study_writes_page_numbers_figures_and_a_machine_that_the_task_takes(
    tmp_path: Path,
) -> None:
    config = LateralLineConfig(
        num_splits=1, num_epochs=10, paper_epochs=3, hidden=[8], windows=[1, 5], noises=[0.0, 1.0],
        learning_rate=0.01,
    )  # fmt: skip
    task = make_task()
    progress = Progress(is_shown=False)
    findings = examine(
        config, task=task, episodes=make_episodes(), folder=tmp_path, progress=progress
    )
    names = {"lateral_line.md", "lateral_line.json", "machine.pt"}
    assert names | {"curves.png", "confusion.png", "limits.png"} == {
        path.name for path in tmp_path.iterdir()
    }
    assert json.loads((tmp_path / "lateral_line.json").read_text())["chance"] == 0.5
    assert f"{findings['machine']['held_out_accuracy']:.1%}" in (
        tmp_path / "lateral_line.md"
    ).read_text(encoding="utf-8")
    machine = LateralLineClassifier.load(tmp_path / "machine.pt")
    machine.check(flows=task.flow_labels, sensors=task.lateral_line_layout)
    assert machine.features == list(LOCAL)


def test_a_fish_in_a_real_flow_is_told_by_its_machine_which_one_it_is() -> None:
    task = make_task(reads_flow_class=True)
    machine = LateralLineClassifier(flows=task.flow_labels, sensors=task.lateral_line_layout)
    transforms = make_recognition(machine, memory=0.0)
    env = make_env(task=task, num_envs=2, compile=False, transforms=transforms)
    rollout = env.rollout(1, break_when_any_done=False)
    named = rollout["next", "flow_probabilities"]
    assert torch.allclose(named, machine(rollout["next", "lateral_line"]).softmax(-1))
    assert rollout["observation_stack"].shape[-1] == task.num_stacked * (task.n_obs + 2)


def test_accuracies_are_written_with_their_range() -> None:
    assert format_accuracies([0.9, 0.8]) == "85.0% [80.0-90.0]"
    assert format_accuracies([0.5]) == "50.0%"
    assert format_accuracies([float("nan")]) == "-"


def test_settings_have_the_papers_number_of_samples_and_epochs() -> None:
    config = load_config("train_lateral_line")
    assert (config.num_samples, config.paper_epochs) == (6000, 1000)


@pytest.mark.parametrize(
    "argument",
    [
        "num_samples=0",
        "noise=-1",
        "weight_decay=-1",
        "windows=[0]",
        "noises=[-0.1]",
        "memories=[-1]",
        "learning_rate=0",
        "window=0",
    ],
)
def test_settings_out_of_range_are_refused(argument: str) -> None:
    with pytest.raises(ConfigError, match=r"must be (at least|greater than)"):
        load_config("train_lateral_line", [argument])
