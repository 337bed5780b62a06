"""What error messages advise: names that exist, and changes that help."""

import ast
import inspect
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
from fishrl.envs import Predation, PredationPair
from fishrl.envs.changes import StreamSwitches
from fishrl.envs.control import Bend, Turn
from fishrl.physics import (
    BounceBack,
    Boundaries,
    Cylinder,
    Fish,
    FlowConfig,
    Free,
    ImmersedBoundary,
    NonEquilibrium,
    Scales,
    Skin,
    compute_tau,
)
from fishrl.programs import view
from fishrl.settings import list_fields
from tests.remedies import ENVS, FLOWS, OUT, Case, complete
from tests.remedies_of_runs import RUNS
from tests.training.conftest import toy_flows  # noqa: F401

FAST, BLURRED = Boundaries(left=NonEquilibrium(velocity=(1.0, 0.0))), ImmersedBoundary()
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


VERBS = {"raise": 1.1, "enlarge": 1.1, "lower": 1 / 1.1, "shorten": 1 / 1.1, "leave out": 0.0}


def follow(message: str, given: dict[str, Any], values: dict[str, Any]) -> dict[str, Any]:
    """Return what a message says to do: for each setting the arguments to try, one after another.

    ``values`` are the defaults.
    """
    found: dict[str, Any] = {}
    subject, _, advice = message.partition(":")
    words = [
        (verb, word)
        for verb, *both in re.findall(rf"\b({'|'.join(VERBS)})\s+(\w+)(?: and (\w+))?", advice)
        for word in both
    ]
    for verb, word in words:
        name = re.split(r"\W", subject)[0] if word == "it" else word
        if name not in {**values, **given}:
            continue
        rest = {key: value for key, value in given.items() if key != name}
        now, factor = {**values, **given}[name], VERBS[verb]
        tries = [scale(now, factor**k) for k in range(1, 100)] if factor else []
        found[name] = [rest | {name: value} for value in tries] or [rest]
    for name, value in re.findall(r"\bgive (?:\w+ = )?(\w+) ?= ?([\w.]+(?:\(\))?)", advice):
        found[name] = [given | {name: eval(value, dict(globals()))}]
    return found


def scale(value: Any, factor: float) -> Any:
    if isinstance(value, tuple):
        return tuple(scale(entry, factor) for entry in value)
    return 2 * round(0.5 * value * factor) if isinstance(value, int) else value * factor


def make_flow(skin: Skin | None = None, **body: Any) -> FlowConfig:
    """Make a flow with one body."""
    kind = Fish if "body_length" in body else Cylinder
    return FlowConfig(
        width=128, height=96, tau=0.6, bodies=(kind(**body),), skin=skin or BounceBack()
    )


def make_bend(response_T: float = 0.3, **given: Any) -> Predation:
    return Predation(control=Bend(response_T=response_T), **given)


CASES: list[tuple[Callable[..., Any], dict[str, Any]]] = [
    (FlowConfig, {"width": 64, "height": 48, "tau": 0.5}),
    (FlowConfig, {"width": 64, "height": 48, "tau": 3.0}),
    (FlowConfig, {"width": 64, "height": 48, "tau": 0.6, "stream_speed": 0.5, "boundaries": FAST}),
    (compute_tau, {"length": 24.0, "speed": 0.07, "reynolds": 20000.0}),
    (compute_tau, {"length": 24.0, "speed": 0.1, "reynolds": 1.0}),
    (Scales, {"body_length": 100, "reynolds": 7000.0, "period": 400}),
    (Scales, {"body_length": 100, "reynolds": 1e6, "period": 600}),
    (Scales.from_budget, {"body_length": 24, "reynolds": 1e5}),
    (make_flow, {"diameter": 20, "inset": 0.4}),
    (make_flow, {"diameter": 20, "num_markers": 20}),
    (make_flow, {"diameter": 20, "marker_spacing": 1.5}),
    (make_flow, {"diameter": 16, "density_ratio": 0.7, "motion": Free(), "skin": BLURRED}),
    (make_bend, {"levels": 1, "wall_margin_bl": 0.01}),
    (Predation, {"reynolds": 1e5}),
    (Predation, {"control": Turn(turn_degrees=170.0), "max_wall_speed": 0.15}),
    (make_bend, {"response_T": 0.05}),
    (Predation, {"start_x_bl": (9.5, 9.6)}),
    (PredationPair, {"start_gap_bl": 4.5}),
    (StreamSwitches, {"interval_T": 0.9}),
]


@pytest.mark.parametrize(("make", "given"), CASES)
def test_what_an_error_advises_helps(make: Callable[..., Any], given: dict[str, Any]) -> None:
    """Each thing that it names is done alone, by degrees; one of them is enough."""
    with pytest.raises(ValueError, match=":") as refused:
        make(**given)
    message = str(refused.value)
    values = {n: p.default for n, p in inspect.signature(make).parameters.items()}
    if isinstance(make, type):
        values |= {entry.name: entry.default for entry in list_fields(make)}
    advice = follow(message, given, values)
    assert advice, message
    every = [changed for tries in advice.values() for changed in tries]
    assert any(is_accepted(make, changed) for changed in every), message


def is_accepted(make: Callable[..., Any], given: dict[str, Any]) -> bool:
    try:
        make(**given)
    except ValueError:
        return False
    return True


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
    make, name, _, good = case
    message, _ = begin(case)
    assert re.search(rf"\b{name}\b", message), message
    assert "None" not in message.rpartition(":")[2]
    make(**{} if good is OUT else {name: good})


def test_all_advice_of_errors_is_tried() -> None:
    tried = set().union(*(begin(case)[1] for case in ALL), *(provoke(*case)[1] for case in CASES))
    advice = {
        (path, line): message
        for path, tree in read_trees().items()
        for line, message in list_messages(tree)
        if ADVISED.search(message)
    }
    left = [message for place, message in advice.items() if place not in tried]
    assert not [message for message in left if not any(part in message for part in UNTRIED)]
    assert all(any(part in message for message in left) for part in UNTRIED)
