"""Command lines: what is composed of files and settings, and how mistakes are answered."""

import random
import re
from collections.abc import Sequence
from itertools import permutations
from pathlib import Path
from typing import Any

import pytest
from omegaconf import OmegaConf

from fishrl.envs import Flows, KarmanGait
from fishrl.envs.control import Bend
from fishrl.programs import evaluate, summarize, train, train_lateral_line, view
from fishrl.programs.configuration import parse, quote, read_value
from fishrl.training import Classifier, open_run
from fishrl.training.checkpoint import Checkpoint
from fishrl.training.logger import CsvLogger
from fishrl.training.run_folder import write_yaml

read = train.main.read


def test_defaults_are_hyperparameters_of_the_paper() -> None:
    settings = read(["preset=paper"])
    found = (settings.gamma, settings.learning_rate, settings.batch_size, settings.tau)
    assert found == (0.99, 5e-4, 64, 0.01)
    assert settings.hidden == (256, 256)


@pytest.mark.parametrize(
    ("arguments", "right"),
    [
        (["totl_frames=3"], "total_frames"),
        (["algoritm=dqn"], "algorithm"),
        (["body_length=20"], "task.body_length"),
        (["task.num_envs=3"], "flows.num_envs"),
        (["device=cuda"], "flows.device"),
        (["task=karman_gait", "task.stream.has_disk=false"], "task.stream.has_disc"),
        (["logger=wandb", "logger.projct=x"], "logger.project"),
        (["preset=quik"], "quick"),
    ],
)
def test_typo_suggests_nearest_setting(arguments: list[str], right: str) -> None:
    with pytest.raises(ValueError, match=f"there is no .* did you mean '{right}'"):
        read(arguments)


def test_key_of_another_object_is_refused() -> None:
    with pytest.raises(ValueError, match=r"no 'task\.stream'.* There is: .*body_length, reynolds"):
        read(["task.stream.has_disc=false"])
    with pytest.raises(ValueError, match=r"there is no 'task\.start_flows'"):
        read(["preset=gait_small", "task=predation"])
    with pytest.raises(ValueError, match=r"there is no 'gap_bl'. There is: seed, "):
        read(["task=karman_gait", "gap_bl=1"])  # far_bl is another word
    with pytest.raises(ValueError, match="there is no 'logger'"):
        evaluate.main.read(["policy=random", "logger=wandb"])


@pytest.mark.parametrize(
    "argument",
    [
        *("small", "seed", "=", "seed=[1", "seed=0,1", "preset=[1.0]", "--config-dir=/nowhere"),
        *("experiment=x", "seed=${sed}"),
    ],
)
def test_malformed_overrides_are_one_line_errors(argument: str) -> None:
    with pytest.raises(ValueError, match=r"\w") as error:
        read([argument])
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["preset=gait_bend", "task.control.rows=1"], "did you mean 'task.control.beat.rows'"),
        (["task=quick"], "'quick' is a preset: give preset=quick"),
        (["preset=follower"], "'follower' is a task: give task=follower"),
        *[([f"{key}=1", "gamma=0.9", f"{prefix}{key}=2"], f"{key}=1, {key}=2: must be one")
          for key in ("seed", "task.levels", "flows.num_envs") for prefix in ("", "+", "++")],
        (["preset=quick", "preset=paper"], "preset=quick, preset=paper: must be one"),
    ],
)  # fmt: skip
def test_word_of_another_place_or_given_twice_is_refused(words: list[str], said: str) -> None:
    with pytest.raises(ValueError, match=re.escape(said)):
        read(words)


@pytest.mark.parametrize("argument", ["preset=null", "logger=null", "preset=[quick]"])
def test_group_is_one_name_or_left_out(argument: str) -> None:
    with pytest.raises(ValueError, match=r"must be one name, or left out"):
        read([argument])


def test_second_word_without_key_is_refused() -> None:
    for program in (summarize, view):
        with pytest.raises(ValueError, match=r"runs/a.*, .*runs/b.*: must be one"):
            program.main.read(["runs/a", "runs/b"])


def write_yaml_file(folder: Path, group: str, text: str) -> str:
    (folder / group).mkdir()
    (folder / group / "own.yaml").write_text(text)
    return f"--config-dir={folder}"


OWN = (
    "{_target_: fishrl.envs.tasks.predation.Predation, body_length: 20, reynolds: 500.0, "
    "wall_margin_bl: 0.3}"
)


def test_precedence_of_defaults_presets_and_command_line(tmp_path: Path) -> None:
    folder = write_yaml_file(tmp_path, "task", OWN)
    write_yaml_file(
        tmp_path,
        "experiment",
        "# @package _global_\ndefaults: [override /preset: quick]\ntask: {body_length: 36}",
    )

    def length(*arguments: str) -> Any:
        return read([folder, *arguments]).task.body_length

    assert length() == 64  # the default of the task
    assert length("task=own") == 20  # no preset is there unless it is asked for
    assert length("task=own", "preset=quick") == length("preset=quick", "task=own") == 32
    assert length("experiment=own", "task=own") == 36
    assert length("task=own", "experiment=own", "task.body_length=40") == 40


def test_preset_brings_its_task() -> None:
    assert isinstance(read(["preset=gait_small"]).task, KarmanGait)
    settings = read(["preset=gait_small", "task=free_stream"])
    assert not settings.task.stream.has_disc
    assert settings.task.body_length == 32


def test_other_programs_take_only_task_of_preset() -> None:
    with_preset = train_lateral_line.main.read(["preset=gait_small", "flows.num_envs=3"])
    plain = train_lateral_line.main.read()
    assert with_preset.task == read(["preset=gait_small"]).task != plain.task
    own = {name: getattr(plain, name) for name in ("task", "preset")}
    assert vars(with_preset) | own == vars(plain) | {"flows": Flows(num_envs=3)}


@pytest.mark.parametrize("order", [*permutations(range(3))])
def test_object_and_arguments_are_given_in_any_order(order: Sequence[int]) -> None:
    control = ("_target_=fishrl.envs.control.Bend", "bend_bl=0.12", "response_T=0.4")
    classifier = ("_target_=fishrl.training.Classifier", "path=zoo/gait_sharp", "memory=0.25")
    words = [f"task.control.{control[i]}" for i in order]
    words += [f"recognition.{classifier[i]}" for i in order]
    found = evaluate.main.read(["policy=zoo/gait_sharp", *words, "task.observes=[place,drift]"])
    assert found.task.control == Bend(bend_bl=0.12, response_T=0.4)
    assert found.recognition == Classifier(path="zoo/gait_sharp", memory=0.25)


def test_resume_needs_one_run(tmp_path: Path) -> None:
    (tmp_path / "one").mkdir()
    write_yaml(tmp_path / "one" / "config.yaml", read().to_config())
    with pytest.raises(ValueError, match="holds runs; name one of them, such as"):
        Checkpoint.find(tmp_path)
    (tmp_path / "config.yaml").write_text("a: [1")
    with pytest.raises(ValueError, match="not the configuration of a run"):
        read([f"resume='{tmp_path}'"])


def test_resumed_run_takes_another_logger_but_no_experiment_or_folder(tmp_path: Path) -> None:
    own = write_yaml_file(tmp_path, "experiment", "log_frames: 7")
    write_yaml(tmp_path / "config.yaml", read(["logger=wandb"]).to_config())
    resume = f"resume='{tmp_path}'"
    for words in (["logger.is_offline=true"], ["logger=wandb", "logger.is_offline=true"]):
        logger: Any = open_run(read([resume, *words])).plan.logger
        assert logger.is_offline
    assert type(open_run(read([resume, "logger=csv"])).plan.logger) is CsvLogger
    for word in ("experiment=own", "folder=x", "name=x"):
        with pytest.raises(ValueError, match=r"is fixed in .*; leave it out"):
            read([own, resume, word])


def draw_words(letters: str, num: int) -> list[str]:
    draw = random.Random(0)
    return ["".join(draw.choices(letters, k=draw.randint(1, 7))) for _ in range(num)]


def test_quoted_word_is_read_verbatim() -> None:
    words = ["null", "1e3", "~/x", *draw_words("ab1 '\"\\${}[](),:=~#%?/é|&<>@*", 40)]
    assert [read_as_hydra(f"folder={quote(word)}") for word in words] == words
    assert read([f"folder={quote(words[-1])}"]).folder == words[-1]


def test_typed_paths_and_names_are_words() -> None:
    given = ["1e3", "true", "0x1", "o'brien", "[x]/é"]
    words = [*given, *draw_words("ab1'\".%?/é|&<>@*=;!#", 40)]
    assert [read_as_hydra(f"folder={read_value(word, is_text=True)}") for word in words] == words
    word = words[-1]
    settings = read([f"baselines=[{word}x]", f"name={word}x", f"folder={word}"])
    assert settings.baselines[0] == settings.name == f"{word}x"
    assert read(["folder=~/x"]).folder == str(Path.home() / "x")
    assert summarize.main.read(["runs/a=1"]).folder == "runs/a=1"


def read_as_hydra(override: str) -> Any:
    """Return the value that an override sets, through a YAML file as hydra composes it."""
    (parsed,) = parse([override])
    config = OmegaConf.create({"folder": parsed.value()})
    return OmegaConf.to_container(config, resolve=True)["folder"]  # type: ignore[index, call-overload]
