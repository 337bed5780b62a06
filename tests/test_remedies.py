"""What error messages advise: names that exist, and changes that help."""

import ast
import re
from collections.abc import Callable, Iterator
from contextlib import chdir
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from traceback import walk_tb
from typing import Any

import gymnasium
import pytest

import fishrl
from fishrl.programs import view
from tests.remedies import ENVS, FLOWS, OUT, Case, complete
from tests.remedies_of_runs import RUNS
from tests.training.conftest import toy_flows  # noqa: F401

SOURCES = sorted(Path(fishrl.__file__).parent.rglob("*.py"))


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kinematic: None) -> None:
    """Work in a folder of its own, without a screen."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(view, "has_screen", lambda: False)


def read_trees() -> dict[Path, ast.AST]:
    return {path: ast.parse(path.read_text(encoding="utf-8")) for path in SOURCES}


def render(node: ast.AST) -> str:
    """Return a text in the source, with {} for what it says about the values."""
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else ""
    if isinstance(node, ast.FormattedValue):
        return "{}"
    parts = node.values if isinstance(node, ast.JoinedStr) else ast.iter_child_nodes(node)
    return "".join(map(render, parts))


def list_messages(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """List the lines and texts of all errors that are raised, or returned to be raised."""
    for node in ast.walk(tree):
        made = getattr(node, "exc", None) or getattr(node, "value", None)
        is_error = isinstance(node, ast.Raise | ast.Return) and isinstance(made, ast.Call)
        if is_error and (isinstance(node, ast.Raise) or ast.unparse(made.func).endswith("Error")):
            yield node.lineno, "".join(map(render, made.args))


def list_names(tree: ast.AST) -> Iterator[str]:
    """List all that a user can name: arguments, fields, functions, attributes, keys, modules."""
    for node in ast.walk(tree):
        if isinstance(node, ast.arg):
            yield node.arg
        elif isinstance(node, ast.Name):
            yield node.id
        elif isinstance(node, ast.Attribute):
            yield node.attr
        elif isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node.name
        elif isinstance(node, ast.Constant) and re.fullmatch(r"\w+", str(node.value)):
            yield str(node.value)


def test_settings_that_errors_name_exist() -> None:
    trees = read_trees()
    known = {name for tree in trees.values() for name in list_names(tree)}
    known |= {path.stem for path in SOURCES}
    found = {
        (path.name, name): message
        for path, tree in trees.items()
        for _, message in list_messages(tree)
        for name in re.findall(r"(?<![\w.])[a-z]+(?:_[a-z0-9]+)+\b", message)
    }
    assert len(found) > 80
    missing = {key: text for key, text in found.items() if key[1] not in known}
    assert not missing


ALL = complete([*FLOWS, *ENVS, *RUNS])
#: What is to be done, at the beginning of a clause.
ADVISED = re.compile(
    r"(?:[:;,] |^|\b(?:or|and) )(?:append|bend|call|change|choose|collect|configure|create|enlarge"
    r"|exclude|free|give|increase|keep|leave|lower|make|measure|move|name|raise|record|remove"
    r"|rename|repair|repeat|reset|score|shorten|slow|stack|start|take|tilt|train|turn|use|wait"
    r"|widen)\b|\bat (?:least|most)\b"
)
#: Advice that is not tried here, and why.
UNTRIED = {
    "and its arguments; got": "tried above, as one error of several, which are raised together",
    "if you trust it, give modules": "tried above, as one error of several",
    "use the fishrl of its scores": "it needs another fishrl",
    "score it again": "a score takes minutes",
    "trust=true": "tests/programs/test_score.py gives it",
    "module:function": "tests/programs/test_score.py gives it",
    "rename one in a subclass": "of an algorithm of one's own",
    "so the policy is lost": "of a training that breaks late",
    "take those, in this order": "tests/training/test_policies.py and test_opening.py take them",
    "give a version, as in": "tests/programs/test_export.py gives one",
    "holds something else than a checkpoint": "tests/training/test_checkpoint.py saves elsewhere",
    "name that of its critics so in a subclass": "the same",
    "choose gives a {}: give its": "of a control of one's own",
    "keep the argument": "of a class of one's own",
    "changes a field: repeat its type": "of a class of one's own",
    "take fewer, or add machines": "it needs a cluster",
    "record it again": "of a damaged recording",
    "frames_per_T = {}: must be": "ViewerSettings checks it first",
    "make another with make_env": "of any attribute",
    "use PPO or SAC": "of another package",
    "an integer of at most 64 bits": "tests/settings/test_every_class.py",
    "sheds too few vortices": "tests/envs/test_wakes.py develops wakes of both durations",
    "diverged: lower max_wall_speed": "it would take minutes",
    "make another env": "it needs a second device",
    "make a new one": "of a solver that was closed, or whose workers have ended",
    "make a new solver": "of a solver that was closed, or whose workers have ended",
    "make another one, and load_state_dict": "tests/physics/fast/test_solver.py does it",
    "append the transform that writes it": "tests/envs/test_transforms.py does it",
    "use another one, such as": "of a damaged checkpoint",
    "any more; give": "tests/presets/test_replaced.py composes each",
    "is a {}: give": "tests/programs/test_configuration.py gives it",
    "has no mirror image; give its": "tests/envs/test_mirror.py gives them to tasks",
}


def provoke(make: Callable[..., Any], given: dict[str, Any]) -> tuple[str, set[tuple[Path, int]]]:
    """Return the message of an error of fishrl, and where it is raised, with those before it."""
    try:
        with TemporaryDirectory() as folder, chdir(folder):
            make(**given)
    except (ValueError, OSError, RuntimeError, TypeError, gymnasium.error.Error) as error:
        message, places, link = str(error), set(), error
        while link is not None:
            frames = [
                (Path(frame.f_code.co_filename), n) for frame, n in walk_tb(link.__traceback__)
            ]
            places |= {place for place in frames if place[0] in SOURCES}
            link = link.__context__
        return message, places
    return pytest.fail("not refused")


@cache
def begin(case: Case) -> tuple[str, set[tuple[Path, int]]]:
    make, name, bad, _ = case
    return provoke(make, {} if bad is OUT else {name: bad})


@pytest.mark.parametrize("case", ALL, ids=lambda case: case[1])
def test_setting_that_an_error_names_helps(case: Case) -> None:
    make, name, bad, good = case
    message, _ = begin(case)
    assert re.search(rf"\b{name}\b", message), message
    subject, _, advice = message.rpartition(":")
    assert "None" not in advice
    for verb, sign in (("raise", 1), ("lower", -1)):
        own = "it|" * subject.startswith(f"{name} =") + name
        if type(good) is type(bad) in (int, float) and re.search(rf"\b{verb} (?:{own})\b", advice):
            assert sign * good > sign * bad
    make(**{} if good is OUT else {name: good})


def test_all_advice_of_errors_is_tried() -> None:
    tried = set().union(*(begin(case)[1] for case in ALL))
    advice = {
        (path, line): message
        for path, tree in read_trees().items()
        for line, message in list_messages(tree)
        if ADVISED.search(message)
    }
    left = [message for place, message in advice.items() if place not in tried]
    assert not [message for message in left if not any(part in message for part in UNTRIED)]
    assert all(any(part in message for message in left) for part in UNTRIED)
