"""Two of every program in one folder, the second one begun at any phase of the first."""

import random
import re
import shutil
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from fishrl.programs.export import TABLE
from fishrl.viewer.fields import WRITERS
from tests.programs.pairs import FIRST, OTHERS, PAIRS, REMEDIES, TRAINING, Pair, read_trainings
from tests.programs.stage import Act, Stage
from tests.smoke.test_programs import list_all_programs


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stage]:
    with closing(Stage(tmp_path_factory.mktemp("stage"))) as stage:
        yield stage


@pytest.fixture(scope="module")
def run(stage: Stage, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two trainings."""
    folder = tmp_path_factory.mktemp("runs")
    for seed in (0, 1):
        words = [*TRAINING, f"name=run{seed or ''}", f"seed={seed}"]
        act = play(stage, Pair(program="train", words=words, read=read_trainings), "", folder)
        act.wait()
        assert act.status == 0, act.said
    return folder


def play(stage: Stage, pair: Pair, value: str, folder: Path, *, hold_at: int = 0) -> Act:
    """Start one program of a pair."""
    words = [word.replace("{}", str(folder)) for word in [*pair.words, value] if word]
    return stage.start(pair.program, words, folder=folder, hold_at=hold_at, glides=pair.glides)


def check(stage: Stage, pair: Pair, folder: Path, *, phase: int | float) -> None:
    """Run a pair; the first waits, at a touch of a file or after some seconds, for the second."""
    is_touch = isinstance(phase, int)
    first = play(stage, pair, pair.values[0], folder, hold_at=phase if is_touch else 0)
    if is_touch:
        first.wait(until_held=True)
    else:
        first.stop(after=phase)
    is_over = first.status is not None
    second = play(stage, pair, pair.values[1], folder)
    second.wait()
    first.let_go()
    first.wait()
    values = []
    for act, value in zip((first, second), pair.values, strict=True):
        assert "Traceback" not in act.said, act.said
        if act.status == 0:
            values.append(value)
        else:
            assert pair.can_refuse, act.said
            (line,) = [line for line in act.said.splitlines() if "error" in line]
            assert re.match(rf"error: .*({REMEDIES})", line)
    assert values, first.said + second.said
    found = sorted(pair.read(folder))
    wanted = [sorted(filter(None, values))]
    wanted += [values[-1:]] if is_over else []  # a file may be replaced once it is written
    wanted += [] if is_touch else [values[:1], values[-1:]]  # not begun, or over
    assert found in wanted, first.said + second.said
    kept = re.compile(r"\.(lock$|z|gitignore)")  # of a run, of zarr, of matplotlib
    assert not [path for path in folder.rglob(".*") if not kept.match(path.name)]


def prepare(name: str, run: Path) -> Path:
    """Make the folder of a pair."""
    folder = run / name.replace(" ", "_")
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    if name == "summary":
        for training in ("run", "run1"):
            shutil.copytree(run / training, folder / training)
    return folder


@pytest.mark.parametrize("name", PAIRS)
def test_two_at_once_keep_their_results_or_are_refused(name: str, stage: Stage, run: Path) -> None:
    touch = random.Random(name).randint(FIRST, max(FIRST, PAIRS[name].touches // 2))
    check(stage, PAIRS[name], prepare(name, run), phase=touch)


@pytest.mark.slow
@pytest.mark.parametrize("draw", range(6))
@pytest.mark.parametrize("name", PAIRS | OTHERS)
def test_two_at_once_at_any_phase(name: str, draw: int, stage: Stage, run: Path) -> None:
    """The first one waits at a touch of a file, or, in the last draws, after some seconds."""
    pair, drawn = (PAIRS | OTHERS)[name], random.Random(f"{name} {draw}")
    phase = drawn.randint(FIRST, pair.touches) if draw < 4 else drawn.uniform(0.0, 4.0)
    check(stage, pair, prepare(name, run), phase=phase)


def test_every_program_and_format_has_a_pair() -> None:
    pairs = (PAIRS | OTHERS).values()
    alone = {"demo", "reproduce"}  # these run the others
    assert list_all_programs() - alone == {pair.program for pair in pairs}
    endings = {Path(word).suffix for pair in pairs for word in pair.words if "save=" in word}
    assert {*WRITERS, TABLE} <= endings


#: The settings of all programs that say where they write.
PLACES = [
    pytest.param(name, word, marks=[pytest.mark.slow] if name in OTHERS else [])
    for name, pair in (PAIRS | OTHERS).items()
    for word in pair.words
    if "{}" in word and not word.startswith(("{}", "run="))
]


@pytest.mark.parametrize(("name", "place"), PLACES)
def test_unwritable_place_is_named_at_once(name: str, place: str, stage: Stage, run: Path) -> None:
    """A file stands where its folder would be."""
    pair, folder, file = (PAIRS | OTHERS)[name], prepare(name, run), run / "file"
    file.touch()
    words = [
        word.replace("{}", str(file if word == place else folder))
        for word in [*pair.words, pair.values[0]]
        if word
    ]
    act = stage.start(pair.program, words, folder=folder, glides=pair.glides, idles=True)
    act.wait()
    assert act.status == 1, act.said
    assert re.search(rf"^error: .*{file}.*({REMEDIES})", act.said, re.MULTILINE), act.said
