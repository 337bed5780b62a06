"""Settings: what is composed of files and command line, and how mistakes are answered."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest
from omegaconf import OmegaConf

from fishrl.envs import AbstractTask, KarmanGait
from fishrl.programs import evaluate, train, train_lateral_line, view
from fishrl.programs.configuration import parse
from fishrl.programs.sweeps.runs import list_arguments
from fishrl.training.checkpoint import read_metadata
from fishrl.training.description import make, to_plain

read = train.main.read


def test_a_setting_reaches_its_argument() -> None:
    settings = read(["num_envs=3", "gamma=1", "task.time_limit=17", "hidden=[8]", "flows=null"])
    assert (settings.num_envs, settings.gamma, list(settings.hidden)) == (3, 1.0, [8])
    assert make(settings.task, kind=AbstractTask).time_limit == 17


def test_the_hyper_parameters_of_the_paper_are_the_defaults() -> None:
    settings = read(["preset=paper"])
    found = (settings.gamma, settings.learning_rate, settings.batch_size, settings.tau)
    assert found == (0.99, 5e-4, 64, 0.01)
    assert list(settings.hidden) == [256, 256]


@pytest.mark.parametrize(
    ("arguments", "right"),
    [
        (["totl_frames=3"], "total_frames"),
        (["algoritm=dqn"], "algorithm"),
        (["task.num_envs=3"], "num_envs"),
        (["task=karman_gait", "task.stream.has_disk=false"], "task.stream.has_disc"),
        (["logger=wandb", "logger.projct=x"], "logger.project"),
        (["preset=smal"], "small"),
    ],
)
def test_a_typo_is_answered_with_the_nearest_right_word(arguments: list[str], right: str) -> None:
    with pytest.raises(ValueError, match=f"there is no .* did you mean '{right}'"):
        read(arguments)


def test_a_key_of_another_object_is_answered_with_those_that_there_are() -> None:
    with pytest.raises(ValueError, match=r"no 'task\.stream'.* There is: .*body_length, reynolds"):
        read(["task.stream.has_disc=false"])
    with pytest.raises(ValueError, match=r"there is no 'task\.start_flows'"):
        read(["preset=gait_small", "task=predation"])
    with pytest.raises(ValueError, match="there is no 'logger'"):
        evaluate.main.read(["policy=random", "logger=wandb"])


@pytest.mark.parametrize(
    ("argument", "wanted"),
    [
        ("num_envs=abc", "Integer"),
        ("compile=maybe", "bool"),
        ("compile=3", "must be true or false"),
        ("hidden=5", "list"),
        ("task.time_limit=long", "Integer"),
        ("task.start_x_bl=[3]", "must hold 2 values"),
    ],
)
def test_a_wrong_type_is_answered_with_key_value_and_type(argument: str, wanted: str) -> None:
    key, value = argument.split("=")
    with pytest.raises(ValueError, match=wanted) as error:
        read([argument])
    assert str(error.value).startswith(key)
    assert value.strip("[]").split(",")[0] in str(error.value)


@pytest.mark.parametrize("argument", ["num_envs=0", "gamma=1.5", "learning_rate=0", "port=80"])
def test_a_value_out_of_range_is_refused(argument: str) -> None:
    with pytest.raises(ValueError, match=argument.split("=")[0]):
        read([argument])


@pytest.mark.parametrize(
    "argument",
    ["small", "seed", "=", "seed=[1", "seed=0,1", "preset=[1.0]", "--config-dir=/nowhere"],
)
def test_what_is_no_single_setting_is_refused_in_one_line(argument: str) -> None:
    with pytest.raises(ValueError, match=r"\w") as error:
        read([argument])
    assert "\n" not in str(error.value)


def test_objects_that_no_file_names_are_those_that_the_task_makes_by_default(
    tmp_path: Path,
) -> None:
    folder = write_task(tmp_path, "_target_: fishrl.envs.tasks.karman_gait.KarmanGait")
    settings = read([folder, "task=own", "task.stream.speeds_bl=[1.0,2.0,3.0]"])
    assert settings.task["stream"]["num_phases"] == 8
    assert settings.task["control"]["bank"]["rows"] == to_plain(KarmanGait().control.bank.rows)
    assert make(settings.task, kind=AbstractTask).stream.speeds_bl == (1.0, 2.0, 3.0)


def write_task(folder: Path, text: str) -> str:
    (folder / "task").mkdir()
    (folder / "task" / "own.yaml").write_text(text)
    return f"--config-dir={folder}"


OWN = (
    "{_target_: fishrl.envs.tasks.predation.Predation, body_length: 20, reynolds: 500.0, "
    "wall_margin_bl: 0.3}"
)


def test_settings_win_in_the_order_default_task_file_preset_command_line(tmp_path: Path) -> None:
    folder = write_task(tmp_path, OWN)

    def length(*arguments: str) -> Any:
        return read([folder, *arguments]).task["body_length"]

    assert length() == 50  # the default of the task
    assert length("task=own") == 20  # no preset is there unless it is asked for
    assert length("task=own", "preset=quick") == 32
    assert length("preset=quick", "task=own") == 32
    assert length("task=own", "preset=quick", "task.body_length=40") == 40


def test_a_preset_brings_its_task_unless_another_one_is_chosen() -> None:
    assert isinstance(make(read(["preset=gait_small"]).task, kind=AbstractTask), KarmanGait)
    settings = read(["preset=gait_small", "task=free_stream"])
    assert not settings.task["stream"]["has_disc"]
    assert settings.task["body_length"] == 32


def test_programs_that_train_nothing_take_only_the_task_of_a_preset() -> None:
    with_preset = train_lateral_line.main.read(["preset=gait_small", "num_envs=3"])
    plain = train_lateral_line.main.read()
    own = {"task", "preset", "num_envs"}
    assert with_preset.num_envs == 3
    assert {n: v for n, v in vars(with_preset).items() if n not in own} == {
        n: v for n, v in vars(plain).items() if n not in own
    }
    assert make(with_preset.task, kind=AbstractTask) == make(
        read(["preset=gait_small"]).task, kind=AbstractTask
    )
    assert make(plain.task, kind=AbstractTask).body_length == 40


def test_a_path_alone_is_a_recording() -> None:
    assert view.main.read(["it's a recording.rrd"]).recording == "it's a recording.rrd"


def stored_run(folder: Path) -> Path:
    settings = read(["num_envs=5", "seed=3"])
    OmegaConf.save(OmegaConf.create(to_plain(asdict(settings))), folder / "config.yaml")
    return folder


def test_a_resumed_run_brings_its_settings_and_takes_new_ones(tmp_path: Path) -> None:
    settings = read([f"resume='{stored_run(tmp_path)}'", "total_frames=9000"])
    assert (settings.num_envs, settings.seed, settings.total_frames) == (5, 3, 9000)


def test_a_resumed_run_of_before_fields_could_be_chosen_keeps_its_limit(tmp_path: Path) -> None:
    path = stored_run(tmp_path) / "config.yaml"
    stored = OmegaConf.load(path)
    del stored["field"], stored["field_limit"]
    stored["vorticity_limit"] = 7.0
    OmegaConf.save(stored, path)
    settings = read([f"resume='{tmp_path}'"])
    assert (settings.field, settings.field_limit) == ("vorticity", 7.0)


@pytest.mark.parametrize("argument", ["num_envs=4", "preset=paper", "task.time_limit=3"])
def test_what_makes_the_result_is_fixed_in_a_run(tmp_path: Path, argument: str) -> None:
    with pytest.raises(ValueError, match="is fixed in"):
        read([f"resume='{stored_run(tmp_path)}'", argument])


def test_a_resume_of_nothing_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"no config\.yaml there"):
        read([f"resume='{tmp_path}'"])
    (tmp_path / "config.yaml").write_text("a: [1")
    with pytest.raises(ValueError, match="not the configuration of a run"):
        read([f"resume='{tmp_path}'"])


def test_a_folder_of_runs_is_no_run(tmp_path: Path) -> None:
    (tmp_path / "one").mkdir()
    stored_run(tmp_path / "one")
    for take in (lambda: read([f"resume='{tmp_path}'"]), lambda: read_metadata(tmp_path)):
        with pytest.raises(ValueError, match="holds runs; name one of them, such as"):
            take()


@pytest.mark.parametrize(
    "folder",
    ["runs/x", "x", "runs/try (2)", "it's/x", "/home/josé/a=1", "[x]/a,b", "a/b c", "null"],
)
def test_the_command_that_resumes_a_run_is_read_for_any_folder(folder: str) -> None:
    (override,) = parse(list_arguments(Path(folder), {}))
    assert str(override.value()) == folder
