"""Groups: each program has its own, every combination fits, and what does not is named."""

from __future__ import annotations

import re

import pytest

from experiments.config import build, check_overrides, load_config
from experiments.settings import ConfigError


@pytest.mark.parametrize("word", ["seed=0,1", "preset=small,paper", "seed=range(0,3)"])
def test_several_values_without_a_sweep_are_answered_with_what_is_missing(word: str) -> None:
    with pytest.raises(ConfigError) as error:
        check_overrides("train", [word])
    assert str(error.value).startswith(f"{word}: several values need --multirun")
    assert "\n" not in str(error.value)
    assert check_overrides("train", [word], is_search=True) == [word]
    for program in ("evaluate", "view", "train_lateral_line"):
        with pytest.raises(ConfigError, match="runs once; give one command for each value"):
            check_overrides(program, ["seed=0,1"])


@pytest.mark.parametrize("algorithms", ["discrete_sac,dqn", "dqn,discrete_sac"])
def test_keys_of_a_sweep_are_checked_for_every_value_of_its_groups(algorithms: str) -> None:
    swept = ["--multirun", f"algorithm={algorithms}"]
    with pytest.raises(ConfigError) as error:
        check_overrides("train", [*swept, "algorithm.epsilon_frames=100"])
    assert "in DiscreteSAC (algorithm=discrete_sac). It takes " in str(error.value)
    assert "Did you mean" not in str(error.value)
    assert len(check_overrides("train", [*swept, "seed=0,1"])) == 3
    swept[1] = "algorithm=dqn,double_dqn"
    assert check_overrides("train", [*swept, "algorithm.epsilon_frames=100"])[-1].startswith("++")


@pytest.mark.parametrize("task", ["predation", "predation,karman_gait", "karman_gait,predation"])
def test_a_preset_of_another_task_is_named_with_its_own(task: str) -> None:
    sweep = ["--multirun"] if "," in task else []
    with pytest.raises(ConfigError) as error:
        check_overrides("train", [*sweep, "preset=gait_small", f"task={task}"])
    assert str(error.value) == (
        "preset=gait_small: is for task=karman_gait, and task=predation takes no task.start_flows; "
        "take another preset, or task=karman_gait"
    )


def test_every_preset_fits_the_tasks_that_are_like_its_own() -> None:
    for task in ("karman_gait", "karman_gait_direct", "free_stream"):
        assert check_overrides("train", ["preset=gait_small", f"task={task}"])
    with pytest.raises(ConfigError, match="preset=gait_half: is for task=karman_gait"):
        check_overrides("train", ["--multirun", "preset=small,gait_half", "task=predation"])


@pytest.mark.parametrize("group", ["task", "preset"])
def test_what_may_lie_in_a_folder_of_ones_own_is_said_to_need_it(group: str) -> None:
    with pytest.raises(ConfigError, match=r"One of your own needs --config-dir <folder>\.$"):
        check_overrides("train", [f"{group}=hold_station"])


@pytest.mark.parametrize(
    ("program", "argument", "groups"),
    [
        ("evaluate", "logger=wandb", "task, preset"),
        ("evaluate", "algorithm.alpha_init=2", "task, preset"),
        ("view", "+algorithm=dqn", "task, preset"),
        ("train_lateral_line", "logger=csv,wandb", "task, preset"),
    ],
)
def test_a_group_that_a_program_has_not_is_answered_with_those_that_it_has(
    program: str, argument: str, groups: str
) -> None:
    with pytest.raises(ConfigError) as error:
        check_overrides(program, [argument])
    name = re.split(r"[.=]", argument.lstrip("+"))[0]
    said = f"{argument}: experiments.{program} has no group {name!r}; it has {groups}"
    assert str(error.value) == said


def test_a_group_is_chosen_with_a_plus_too() -> None:
    assert check_overrides("train", ["+preset=paper"]) == ["preset=paper"]


def test_a_machine_is_made_for_a_preset_whose_settings_of_training_stay_out() -> None:
    config = load_config("train_lateral_line", ["preset=gait_small", "num_envs=3"])
    plain = load_config("train_lateral_line")
    assert (config.preset, config.num_envs, plain.preset) == ("gait_small", 3, None)
    own = {"task", "preset", "num_envs"}
    assert {n: v for n, v in vars(config).items() if n not in own} == {
        n: v for n, v in vars(plain).items() if n not in own
    }
    made, trained = build(config.task), build(load_config("train", ["preset=gait_small"]).task)
    assert made == trained
    by_hand = ["task.body_length=32", "task.max_wall_speed=0.15"]
    shown = build(load_config("train_lateral_line", by_hand).task)
    assert made.flow_labels == shown.flow_labels
    assert made.lateral_line_layout == shown.lateral_line_layout
    assert made.start_x_bl != shown.start_x_bl  # so the pages keep what was measured


def test_a_lateral_line_without_a_preset_is_trained_as_ever() -> None:
    task = build(load_config("train_lateral_line").task)
    assert (type(task).__name__, task.body_length, task.start_flows) == (
        "KarmanGait",
        40,
        (0, 1, 2),
    )
    with pytest.raises(ConfigError, match="num_envs=x: must be a whole number"):
        load_config("train_lateral_line", ["num_envs=x"])
    with pytest.raises(ConfigError, match="window"):
        load_config("train_lateral_line", ["window=x"])
