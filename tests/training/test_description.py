"""Objects are written as plain data and made again; a file cannot name other code."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from fishrl.envs import AbstractTask, KarmanGait, Predation
from fishrl.envs.macro_actions import DirectFrequencies
from fishrl.training.aliases import ALIASES, DEFAULT_ALGORITHM, update_config, update_names
from fishrl.training.description import describe, find_class, make


class Plain:
    def __init__(self, *, size: int, names: tuple[str, ...] = (), parts: Any = None) -> None:
        self.size, self.names, self.parts = size, names, parts


class Hiding:
    def __init__(self, *, size: int) -> None:
        self._size = size


@pytest.mark.parametrize(
    "task",
    [
        Predation(food_speed_bl=0.1),
        KarmanGait(start_flows=(1,), control=DirectFrequencies(frequencies=(0.0, 1.0, 2.0))),
    ],
    ids=lambda task: type(task).__name__,
)
def test_a_task_is_the_same_after_a_trip_through_a_file(task: AbstractTask) -> None:
    assert make(json.loads(json.dumps(describe(task))), kind=AbstractTask) == task


def test_a_plain_class_is_described_by_its_constructor() -> None:
    node = describe(Plain(size=3, names=("a", "b")))
    again = make(node, kind=Plain)
    assert (again.size, again.names, again.parts) == (3, ["a", "b"], None)
    with pytest.raises(ValueError, match="keep the argument 'size'"):
        describe(Hiding(size=3))
    with pytest.raises(ValueError, match="cannot be written"):
        describe(Plain(size=3, parts=print))


@pytest.mark.parametrize(
    "target",
    [
        "os.system",  # imported, but no class
        "pathlib.Path",  # a class of another kind
        "fishrl.envs.streams.Stream",
        "fishrl.training.description.importlib.import_module",
        "antigravity.Task",  # what nobody imported is not imported
        "fishrl.nowhere.Task",
        "Task",
        "",
    ],
)
def test_a_file_can_name_classes_of_the_expected_kind_only(target: str, tmp_path: Path) -> None:
    ran = tmp_path / "ran"
    for node in (
        {"_target_": target, "command": f"touch {ran}"},
        {"_target_": "fishrl.envs.KarmanGait", "stream": {"_target_": "os.system"}},
        {
            "_target_": "fishrl.envs.KarmanGait",
            "body_length": {"_target_": "fishrl.envs.Predation"},
        },
        {"_target_": f"{__name__}.Plain", "size": 1, "parts": {"_target_": "os.system"}},
    ):
        with pytest.raises(ValueError, match="_target_"):
            make(node, kind=Plain if "size" in node else AbstractTask)
    assert "antigravity" not in sys.modules
    assert not ran.exists()


def test_a_module_of_ones_own_is_imported_if_the_user_names_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "swims_off.py").write_text(
        "from fishrl.envs.flow_env import AbstractTask\nclass Drift(AbstractTask): pass\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(ValueError, match=r"give modules=\[swims_off\]"):
        find_class("swims_off.Drift", kind=AbstractTask)
    found = find_class("swims_off.Drift", kind=AbstractTask, modules=["swims_off"])
    assert found.__name__ == "Drift"
    monkeypatch.delitem(sys.modules, "swims_off")


@pytest.mark.parametrize(
    ("node", "said"),
    [
        ({"_target_": "fishrl.envs.Predation", "body_lenght": 3}, "did you mean 'body_length'"),
        ({"_target_": "fishrl.envs.Predation", "time_limit": "long"}, "time_limit = .long"),
        ({"_target_": "fishrl.envs.AbstractTask"}, "abstract"),
        ({"body_length": 3}, "give a _target_"),
        ("fishrl.envs.Predation", "give a _target_"),
    ],
)
def test_a_description_that_does_not_fit_is_refused(node: Any, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        make(node, kind=AbstractTask)


def test_a_class_of_the_script_that_runs_has_the_name_that_others_import_it_by(
    tmp_path: Path,
) -> None:
    script = tmp_path / "own.py"
    script.write_text(
        "from fishrl.envs import Predation\n"
        "from fishrl.training.description import describe, make\n"
        "class Own(Predation): pass\n"
        "if __name__ == '__main__':\n"
        "    written = describe(Own())\n"
        "    print(written['_target_'], type(make(written, kind=Own)) is Own)\n"
    )
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["own.Own", "True"]


def test_former_names_lead_to_classes_of_today() -> None:
    for name, new in ALIASES.items():
        found = find_class(name, kind=object)
        assert new == f"{found.__module__}.{found.__qualname__}"
    old = {"parts": [{"_target_": next(iter(ALIASES)), "size": 3}]}
    assert update_names(old)["parts"] == [{"_target_": next(iter(ALIASES.values())), "size": 3}]


def test_settings_of_earlier_runs_are_found_in_their_places_of_today() -> None:
    old = {"alpha_init": 0.5, "vorticity_limit": 7.0, "seed": 3}
    algorithm = DEFAULT_ALGORITHM | {"alpha_init": 0.5}
    assert update_config(old) == {"algorithm": algorithm, "field_limit": 7.0, "seed": 3}
    assert update_config(update_config(old)) == update_config(old)
