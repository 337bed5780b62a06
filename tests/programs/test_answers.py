"""Programs answer odd values of their settings within 5 s: they take them, or say why not."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from itertools import cycle
from typing import Any

import pytest

from experiments import benchmark, reproduce, validate
from fishrl.envs import Predation
from fishrl.memory import check_memory
from fishrl.programs import (
    configuration,
    evaluate,
    search,
    train,
    train_lateral_line,
    transfer,
    view,
)
from fishrl.programs.program import Program
from fishrl.settings import REQUIRED, describe, to_plain
from fishrl.training import LearningSettings, RunSettings
from fishrl.training import train as train_policy

PROGRAMS: dict[str, tuple[Program, tuple[str, ...]]] = {
    "train": (train.main, ()),
    "train drqn": (train.main, ("algorithm=drqn", "preset=gait_small")),
    "evaluate": (evaluate.main, ("policy=random",)),
    "view": (view.main, ("policy=random", "save=x.rrd")),
    "transfer": (transfer.main, ()),
    "train_lateral_line": (train_lateral_line.main, ()),
    "reproduce": (reproduce.main, ("plan=true",)),
    "benchmark": (benchmark.main, ()),
    "validate": (validate.main, ()),
    "search": (search.main, ("folder=x", "gamma=interval(0.9,1)")),
}
ODD = ("nan", "inf", "-inf", "-1", "0", "0.5", "1e300", "1e-300", str(10**30), str(10**400))
WORDS = ("null", "true", "x", "''", "[]", "[nan]", "[1,-1]", "[1e9]", "{a:1}")


def list_keys(name: str) -> list[str]:
    """Return the settings of a program, for ``train`` with those below others."""
    main, words = PROGRAMS[name]
    values = main.list_defaults(words)
    if name == "train":
        plain = {key: to_plain(value) for key, value in values.items() if value is not REQUIRED}
        values = configuration.flatten(plain)
    return sorted(key for key in values if key not in ("task", "modules") and "_target_" not in key)


def flatten(value: Any) -> Iterator[Any]:
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list | tuple):
        for entry in value:
            yield from flatten(entry)
    else:
        yield value


@pytest.mark.parametrize("name", PROGRAMS)
def test_a_program_takes_a_value_or_refuses_it_in_one_line(name: str) -> None:
    """Each of its settings has one value; ``train`` has enough for all values."""
    main, words = PROGRAMS[name]
    for key, value in zip(list_keys(name), cycle((*ODD, *WORDS)), strict=False):
        taken, said, began = {}, "", time.process_time()
        try:
            taken = describe(main.read([*words, f"{key}={value}"]))
        except (ValueError, ImportError, OSError) as error:
            said = str(error)
        assert time.process_time() - began < 5.0, (key, value)
        assert len(said.splitlines()) <= 3, (key, value, said)
        numbers = [number for number in flatten(taken) if isinstance(number, float)]
        assert all(map(math.isfinite, numbers)), (key, value)


@pytest.mark.parametrize(
    "sizes",
    [{"num_envs": 10**6}, {"buffer_size": 10**14}, {"hidden": (10**9,)}, {"domain_bl": (1e6, 1e6)}],
    ids=str,
)
def test_what_cannot_fit_into_memory_is_refused_with_the_estimate(
    sizes: dict[str, Any], tmp_path: Any
) -> None:
    given_words = dict(sizes)
    of_task = {n: given_words.pop(n) for n in sizes if n == "domain_bl"}
    with pytest.raises(ValueError, match=r"flows .* GB, buffer .* GB, networks .* GB: more than"):
        train_policy(
            task=Predation(**of_task),
            learning=LearningSettings(**given_words),
            run=RunSettings(folder=str(tmp_path / "runs")),
        )
    assert not (tmp_path / "runs").exists()
    check_memory(flows=1e6)
