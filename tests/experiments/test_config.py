"""Settings: every typo is named with the nearest right word, every wrong value with the remedy."""

from __future__ import annotations

import inspect
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from omegaconf import OmegaConf

from experiments.config import CONF, build, check_overrides, load_config, resumed_settings, to_plain
from experiments.settings import ConfigError, EvaluateConfig, TrainConfig, check_device
from experiments.sweeps.runs import read_runs
from fishrl.training.checkpoint import read_metadata

ROOT = Path(__file__).parents[2]
PRESETS = sorted(path.stem for path in (CONF / "preset").glob("*.yaml"))


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("logger", ["csv", "wandb"])
def test_every_choice_of_presets_and_loggers_makes_settings(preset: str, logger: str) -> None:
    config = load_config("train", [f"preset={preset}", f"logger={logger}"])
    assert isinstance(config, TrainConfig)
    assert config.preset == preset
    assert build(config.task).num_actions == 3


def test_presets_of_the_issue_are_there() -> None:
    assert {"small", "paper"} <= set(PRESETS)


def test_the_hyper_parameters_of_the_paper_are_the_defaults() -> None:
    config = load_config("train", ["preset=paper"])
    assert (config.gamma, config.learning_rate, config.batch_size, config.tau) == (
        0.99,
        5e-4,
        64,
        0.01,
    )
    assert config.hidden == [256, 256]


def test_an_override_reaches_its_argument() -> None:
    config = load_config("train", ["num_envs=3", "gamma=0.9", "task.time_limit=17", "hidden=[8]"])
    assert (config.num_envs, config.gamma, config.hidden) == (3, 0.9, [8])
    assert build(config.task).time_limit == 17


def test_every_plain_argument_of_the_task_can_be_seen_and_set() -> None:
    from fishrl.envs.tasks.predation import Predation

    config = load_config("train")
    plain = {
        name
        for name, parameter in inspect.signature(Predation).parameters.items()
        if isinstance(parameter.default, bool | int | float | str)
    }
    assert plain <= set(config.task)


@pytest.mark.parametrize(
    ("argument", "right"),
    [
        ("totl_frames=3", "total_frames"),
        ("num_env=3", "num_envs"),
        ("task.time_limt=3", "task.time_limit"),
        ("task.num_envs=3", "num_envs"),
        ("logger.projct=x", "logger.project"),
        ("prest=small", "preset"),
        ("preset=smal", "small"),
        ("task=predatoin", "predation"),
        ("logger=wandbb", "wandb"),
        ("preset=small,papper", "paper"),
        ("preset=choice(small,papper)", "paper"),
        ("+gama=0.9", "gamma"),
    ],
)
def test_a_typo_is_named_with_the_nearest_right_word(argument: str, right: str) -> None:
    wrong = argument.lstrip("+").split("=")
    given = ["logger=wandb", argument] if "logger." in argument else [argument]
    with pytest.raises(ConfigError, match=f"Did you mean '{right}'") as error:
        check_overrides("train", given)
    assert any(part.split(",")[-1] in str(error.value) for part in wrong)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["task.stream.has_disc=false"], "in Predation. It takes body_length, reynolds, "),
        (
            ["task=karman_gait", "task.stream.colour=red"],
            "'task.stream.colour' in Stream. It takes speeds_bl, has_disc, ",
        ),
        (
            ["algorithm.sequence_length=4"],
            "in DiscreteSAC. It takes alpha_init, target_entropy_weight.",
        ),
        (
            ["logger.is_offline=true"],
            "there is no 'logger.is_offline' in CsvLogger. It takes nothing.",
        ),
    ],
)
def test_a_key_of_another_object_is_answered_with_those_that_there_are(
    given: list[str], said: str
) -> None:
    with pytest.raises(ConfigError) as error:
        check_overrides("train", given)
    assert said in str(error.value)
    assert "Did you mean" not in str(error.value)


def test_the_evaluation_names_typos_too() -> None:
    with pytest.raises(ConfigError, match="Did you mean 'checkpoint'"):
        check_overrides("evaluate", ["chekpoint=runs/x"])


@pytest.mark.parametrize("argument", ["small", "num_envs", "seed=[1"])
def test_an_argument_that_is_no_setting_is_explained(argument: str) -> None:
    with pytest.raises(ConfigError, match="written key=value"):
        check_overrides("train", [argument])


@pytest.mark.parametrize(
    ("argument", "said"),
    [
        ("num_envs=abc", "num_envs=abc: must be a whole number"),
        ("num_envs=2.5", "num_envs=2.5: must be a whole number"),
        ("gamma=high", "gamma=high: must be a number"),
        ("compile=3", "compile=3: must be true or false"),
        ("task.time_limit=long", "task.time_limit=long: must be a whole number"),
        ("hidden=[a]", "hidden"),
        ("hidden=5", r"hidden=5: must be a list in brackets, such as \[256,256\]"),
        ("hidden=abc", "hidden=abc: must be a list in brackets"),
        ("baselines=random", "baselines=random: must be a list in brackets"),
        ("flows=1", "flows=1: must be a list in brackets"),
        (
            "task.start_x_bl=3",
            r"task.start_x_bl=3: must be a list in brackets, such as \[5.0,7.5\]",
        ),
        ("task.start_x_bl=[3]", r"task.start_x_bl=\[3\]: must be a list of 2 numbers, such as"),
        ("task.start_x_bl=[a,b]", "must be a list of 2 numbers"),
        ("num_envs=0", "num_envs = 0: must be at least 1"),
        ("num_envs=-2", "num_envs = -2: must be at least 1"),
        ("total_frames=0", "total_frames = 0: must be at least 1"),
        ("batch_size=0", "batch_size = 0: must be at least 1"),
        ("buffer_size=32", "batch_size = 64: must be at most buffer_size = 32"),
        ("updates_per_frame=-1", "updates_per_frame = -1.*: must be at least 0"),
        ("warmup_frames=-1", "warmup_frames = -1: must be at least 0"),
        ("gamma=1.5", "gamma = 1.5: must be at most 1"),
        ("tau=-0.1", "tau = -0.1: must be at least 0"),
        ("learning_rate=0", "learning_rate = 0.*: must be greater than 0"),
    ],
)
def test_a_wrong_value_is_named_with_what_is_allowed(argument: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        load_config("train", [argument])


def test_lists_of_whole_numbers_and_of_any_length_are_taken_where_they_fit() -> None:
    check_overrides("train", ["task.start_x_bl=[2,3]", "hidden=[8,8,8]", "baselines=[]"])
    gait = ["task=karman_gait", "preset=gait_small", "task.start_flows=[0,2]"]
    check_overrides("train", [*gait, "task.stream.speeds_bl=[1]", "flows=null"])


def test_options_and_sweeps_of_hydra_pass() -> None:
    given = ["--multirun", "seed=0,1", "preset=small,paper", "hydra.verbose=true"]
    assert sorted(check_overrides("train", given)) == sorted(given)


@pytest.mark.parametrize("program", ["evaluate", "train_lateral_line"])
@pytest.mark.parametrize("word", ["--multirun", "-m", "hydra.mode=MULTIRUN"])
def test_only_trainings_are_swept(program: str, word: str) -> None:
    with pytest.raises(ConfigError, match=f"{word}: experiments.{program} runs once; give one"):
        check_overrides(program, [word, "seed=0,1"])


@pytest.mark.parametrize("given", [[], ["checkpoint=runs/x", "policy=random"]])
def test_an_evaluation_is_of_one_fish(given: list[str]) -> None:
    with pytest.raises(ConfigError, match="give one of checkpoint="):
        load_config("evaluate", given)


@pytest.mark.parametrize("name", ["num_envs", "episodes"])
def test_an_evaluation_needs_at_least_one(name: str) -> None:
    with pytest.raises(ConfigError, match=f"{name} = 0: must be at least 1"):
        load_config("evaluate", ["policy=random", f"{name}=0"])


def test_yaml_sets_only_what_deviates_and_every_key_is_read() -> None:
    settings = {"train": TrainConfig, "evaluate": EvaluateConfig}
    for program, schema in settings.items():
        names = set(inspect.signature(schema).parameters)
        keys = set(OmegaConf.load(CONF / f"{program}.yaml")) - {"defaults", "hydra"}
        assert keys <= names
    for preset in PRESETS:
        keys = set(OmegaConf.load(CONF / "preset" / f"{preset}.yaml")) - {"defaults"}
        assert keys <= set(inspect.signature(TrainConfig).parameters)


def test_cuda_that_is_asked_for_and_absent_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    check_device("cpu")
    with pytest.raises(ConfigError, match="no CUDA device here; take device=cpu"):
        check_device("cuda")
    with pytest.raises(ConfigError, match="no CUDA device here; take device=cpu"):
        check_device("cuda:1")


@pytest.mark.parametrize("device", ["gpu", "meta", "cuda:x"])
def test_a_device_that_is_none_is_an_error(device: str) -> None:
    with pytest.raises(ConfigError, match="must be cpu, cuda or cuda:<number>"):
        check_device(device)


def test_a_target_that_cannot_be_made_says_why() -> None:
    with pytest.raises(ConfigError, match="nothing_there"):
        build({"_target_": "fishrl.training.logger.nothing_there"})
    with pytest.raises(ValueError, match="time_limit = 0: must be at least 1"):
        build({"_target_": "tests.training.toy_fish.ToyPredation", "time_limit": 0})


def stored_run(folder: Path) -> Path:
    config = load_config("train", ["num_envs=5", "seed=3"])
    OmegaConf.save(OmegaConf.create(to_plain(config)), folder / "config.yaml")
    return folder


def test_a_resumed_run_brings_its_settings_and_takes_new_ones(tmp_path: Path) -> None:
    settings = resumed_settings(str(stored_run(tmp_path)), ["total_frames=9000"])
    assert (settings.num_envs, settings.seed, settings.total_frames) == (5, 3, 9000)


@pytest.mark.parametrize(
    "argument",
    [
        *("num_envs=4", "seed=1", "preset=paper", "task=predation", "++task.time_limit=3"),
        *("learning_rate=1e-4", "gamma=0.9", "batch_size=32", "updates_per_frame=8"),
        *("warmup_frames=0", "tau=0.1"),
    ],
)
def test_what_a_run_has_learned_with_is_not_changed_on_resume(
    tmp_path: Path, argument: str
) -> None:
    with pytest.raises(ConfigError, match="is fixed in"):
        resumed_settings(str(stored_run(tmp_path)), [argument])


@pytest.mark.parametrize(
    "argument",
    [
        *("task.stream.has_disc=false", "algorithm.sequence_length=4", "logger.is_offline=true"),
        *("task=nothing", "preset=smal", "+task.time_limit=3"),
    ],
)
def test_what_is_fixed_is_said_whatever_the_task_of_the_run(tmp_path: Path, argument: str) -> None:
    run = stored_run(tmp_path)
    fixed = re.escape(
        f"{argument.lstrip('+')}: {re.split('[.=]', argument.lstrip('+'))[0]} is fixed in {run}"
    )
    with pytest.raises(ConfigError, match=fixed):
        check_overrides("train", [f"resume='{run}'", argument])
    with pytest.raises(ValueError, match=r"no config\.yaml there"):
        check_overrides("train", [f"resume='{tmp_path / 'none'}'", argument])
    with pytest.raises(ConfigError, match="there is no"):
        check_overrides("train", ["resume=null", "totl_frames=3"])


def test_a_resume_of_nothing_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"no config\.yaml there"):
        resumed_settings(str(tmp_path), [])
    (tmp_path / "config.yaml").write_text("a: [1")
    with pytest.raises(ConfigError, match="not the configuration of a run"):
        resumed_settings(str(tmp_path), [])
    (tmp_path / "config.yaml").write_text("colour: red")
    with pytest.raises(ConfigError, match="not the configuration of a run"):
        resumed_settings(str(tmp_path), [])


def test_a_folder_of_runs_is_no_run(tmp_path: Path) -> None:
    (tmp_path / "one").mkdir()
    said = f"{tmp_path}: holds runs; name one of them, such as {stored_run(tmp_path / 'one')}"
    with pytest.raises(ValueError, match=re.escape(f"resume = {said}")):
        resumed_settings(str(tmp_path), [])
    with pytest.raises(ValueError, match=re.escape(f"checkpoint = {said}")):
        read_metadata(tmp_path)
    with pytest.raises(ValueError, match="is a single run; give the folder that holds it, /"):
        read_runs(tmp_path / "one")


def run_program(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", *arguments],
        cwd=ROOT,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        check=False,
        capture_output=True,
        text=True,
    )


def test_a_typo_on_the_command_line_ends_the_program_with_one_line(tmp_path: Path) -> None:
    done = run_program("experiments.train", "totl_frames=3", f"folder={tmp_path}")
    assert done.returncode == 1
    assert "error: totl_frames=...: there is no 'totl_frames'. Did you mean 'total_frames'?" in (
        done.stderr
    )
    assert "Traceback" not in done.stderr
    assert "set-up" in done.stderr  # the bar was there before the mistake was found
    assert not list(tmp_path.iterdir())


def test_a_checkpoint_that_is_missing_ends_the_program_with_one_line(tmp_path: Path) -> None:
    done = run_program("experiments.evaluate", f"checkpoint={tmp_path / 'none'}")
    assert done.returncode == 1
    assert "there is none; give the folder of a run" in done.stderr
    assert "Traceback" not in done.stderr


def test_the_bar_does_not_wait_for_torch() -> None:
    done = run_program("experiments.train", "--version")
    assert "set-up" in done.stderr
    code = "import sys, experiments.train; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=False).returncode == 0
