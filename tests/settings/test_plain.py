"""Objects are written as plain data and made again; a file cannot name other code."""

import subprocess
import sys
from collections.abc import Mapping
from dataclasses import field
from enum import Enum
from pathlib import Path
from typing import Any, ClassVar

import pytest
from pydantic import PositiveInt

from fishrl.envs import AbstractTask
from fishrl.settings import Settings, build, describe, to_plain


class Colour(Enum):
    RED = (1, 0)
    DARK_RED = (2, 0)


class Line(Settings):
    size: PositiveInt = 16
    features: tuple[str, ...] = ("pressure", "velocity")
    colour: Colour = Colour.RED


class Gait(Settings):
    speed: float = 1.0

    def __post_init__(self) -> None:
        if self.speed > 9:
            raise ValueError(f"speed = {self.speed}: must be that of a fish")


class WideGait(Gait):
    speed: float = 2.0


class GivenGait(Gait):
    width: float


class Task(Settings):
    former: ClassVar[Mapping[str, str]] = {"swim": "give gait=wide-gait"}

    gap_bl: float = 1.0
    line: Line = Line(features=("pressure",))
    gait: Gait | None = None
    gaits: tuple[Gait, ...] = ()
    more: Mapping[str, Any] = field(default_factory=dict)


class Plain:
    def __init__(self, *, size: int, names: tuple[str, ...] = (), parts: Any = None) -> None:
        self.size, self.names, self.parts = size, names, parts


class Hiding:
    def __init__(self, *, size: int) -> None:
        self._size = size


class Training(Settings):
    task: Task
    logger: Plain | None = None
    seed: int = 0


TASK = f"{__name__}.Task"


def errors_of(node: Any) -> list[str]:
    with pytest.raises(ValueError) as caught:  # noqa: PT011  # the message is returned
        build(Training, node)
    if "that of a fish" in str(caught.value):
        assert any(entry.name == "__post_init__" for entry in caught.traceback)  # what raised it
    return str(caught.value).splitlines()


def test_node_without_target_changes_default_of_its_field() -> None:
    made = build(Training, {"task": {"line": {"size": 4}, "gait": {"speed": 2}}})
    assert made.task.line == Line(size=4, features=("pressure",))
    assert made.task.gait == Gait(speed=2)
    named = build(Task, {"line": {"_target_": f"{__name__}.Line", "size": 4}})
    assert named.line == Line(size=4)


def test_each_error_has_a_line_with_dotted_key() -> None:
    node = {"task": {"line": {"size": 0, "featurs": 1}, "gap_bl": "x"}, "seed": 1.5}
    assert errors_of(node) == [
        "there is no 'task.line.featurs'; did you mean 'task.line.features'?",
        "task.line.size = 0: must be greater than 0",
        "task.gap_bl = 'x': must be a valid number",
        "seed = 1.5: must be a valid integer",
    ]


@pytest.mark.parametrize(
    ("node", "line"),
    [
        ({"task": {}, "gap_bl": 1}, "there is no 'gap_bl'; did you mean 'task.gap_bl'?"),
        ({"task": {}, "siz": 1}, "there is no 'siz'; did you mean 'task.line.size'?"),
        ({"task": {"colour": 1}}, "there is no 'task.colour'; did you mean 'task.line.colour'?"),
        (
            {"task": {}, "logger": {"size": 1, "gaps": 3}},
            "there is no 'logger.gaps'. There is: size, names, parts",
        ),
        ({"task": {}, "xyz": 1}, "there is no 'xyz'. There is: task, logger, seed"),
        ({}, "task: has no default, so it must be given"),
        ({"task": None}, "task = None: must be Task(...)"),
        ({"task": {"gait": {"speed": 10}}}, "task.gait.speed = 10.0: must be that of a fish"),
        (
            {"task": {"line": {"colour": "BLUE"}}},
            "task.line.colour = 'BLUE': must be one of red, dark-red",
        ),
        ({"task": {}, "logger": {"size": "3"}}, "logger.size = '3': must be a valid integer"),
        ({"task": {}, "logger": {"sice": 3}}, "logger.size: has no default, so it must be given"),
        (
            {"task": {"gait": "wide-gate"}},
            "task.gait = 'wide-gate': must be one of gait, wide-gait, or give task.gait.width=...; "
            "did you mean 'wide-gait'?",
        ),
        ({"task": {"swim": "wide"}}, "task.swim: give gait=wide-gait"),
        ("Training", "give a _target_ and its arguments; got 'Training'"),
    ],
    ids=str,
)
def test_error_names_key_and_nearest_word(node: Any, line: str) -> None:
    assert line in errors_of(node)


def test_plain_class_is_described_by_its_constructor() -> None:
    again = build(Plain, describe(Plain(size=3, names=("a", "b"))))
    assert (again.size, again.names, again.parts) == (3, ("a", "b"), None)
    with pytest.raises(ValueError, match="keep the argument 'size'"):
        describe(Hiding(size=3))
    with pytest.raises(ValueError, match="cannot be written"):
        describe(Plain(size=3, parts=print))
    with pytest.raises(ValueError, match="give a _target_"):
        build(AbstractTask, {"body_length": 3})
    assert to_plain({"path": Path("a"), "colour": Colour.RED}) == {"path": "a", "colour": "red"}


@pytest.mark.parametrize(
    "target",
    [
        "os.system",  # imported, but no class
        "pathlib.Path",  # a class of another kind
        f"{__name__}.Line",
        "fishrl.settings.plain.importlib.import_module",
        "antigravity.Task",  # what nobody imported is not imported
        "fishrl.nowhere.Task",
        "Task",
        "",
        3,
    ],
)
def test_files_name_only_classes_of_expected_type(target: Any, tmp_path: Path) -> None:
    ran = tmp_path / "ran"
    for node in (
        {"_target_": target, "command": f"touch {ran}"},
        {"_target_": TASK, "gait": {"_target_": target}},
        {"_target_": TASK, "gaits": [{"_target_": target}]},
        {"_target_": TASK, "gap_bl": {"_target_": target}},
    ):
        with pytest.raises(ValueError, match="_target_"):
            build(Task, node)
    with pytest.raises(ValueError, match="_target_"):
        build(Plain, {"size": 1, "parts": {"_target_": target}})
    assert "antigravity" not in sys.modules
    assert not ran.exists()


def test_class_of_running_script_has_importable_name(tmp_path: Path) -> None:
    script = tmp_path / "own.py"
    script.write_text(
        "from fishrl.settings import Settings, build, describe\n"
        "class Own(Settings):\n    size: int = 3\n"
        "if __name__ == '__main__':\n"
        "    written = describe(Own())\n"
        "    print(written['_target_'], type(build(Own, written)) is Own)\n"
    )
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["own.Own", "True"]


@pytest.mark.parametrize("word", ["DARK_RED", "dark-red", "dark_red"])
def test_enumeration_member_is_given_by_name(word: str) -> None:
    assert build(Line, {"colour": word}).colour is Colour.DARK_RED
    with pytest.raises(ValueError, match="must be one of red, dark-red; did you mean 'dark-red'"):
        build(Line, {"colour": f"{word}x"})


def test_word_makes_object_of_its_class() -> None:
    task = build(Task, {"gait": "wide-gait", "gaits": ["gait", "wide-gait"]})
    assert task == Task(gait=WideGait(), gaits=(Gait(), WideGait()))
    assert to_plain(task)["gait"] == {"_target_": f"{__name__}.WideGait", "speed": 2.0}
    assert build(Task, {"gait": {"_target_": "wide-gait", "speed": 4}}).gait == WideGait(speed=4)


def test_arguments_of_one_class_alone_make_it() -> None:
    assert build(Task, {"gait": {"width": 3}}).gait == GivenGait(width=3.0)
    with pytest.raises(
        ValueError, match=r"must be one of gait, wide-gait, or give gait\.width=\.\.\."
    ):
        build(Task, {"gait": "runs/gait.pt"})


def test_removed_setting_names_replacement() -> None:
    with pytest.raises(ValueError, match=r"^swim: give gait=wide-gait$"):
        Task(swim=1)  # type: ignore[call-arg]

    class Race(Task):
        former: ClassVar[Mapping[str, str]] = {"lane": "give gap_bl"}

    assert Race.former == {**Task.former, "lane": "give gap_bl"}
