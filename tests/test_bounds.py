"""Every number of a settings dataclass is finite, of its kind and within its bounds."""

from dataclasses import dataclass
from math import inf, nan
from typing import Any

import numpy as np
import pytest

from fishrl.bounds import bounded, check_bounds, suggest


@dataclass(frozen=True, kw_only=True)
class Settings:
    count: int = bounded(1, least=1)
    share: float = bounded(0.5, least=0, largest=1)
    rate: float = bounded(1.0, greater=0)
    part_of_two: float = bounded(1.0, greater=0, less=2)
    free: float = 0.0
    limit: float | None = bounded(None, greater=0)
    sizes: tuple[int, ...] = bounded((1, 2), least=1, entries=1)
    vector: tuple[float, float] = bounded((0.0, 0.0), norm=0.5)
    pair: tuple[int, int] | None = None
    rows: tuple[tuple[float, ...], ...] = bounded(((1.0,),), greater=0)
    part: Any = None
    is_on: bool = True
    name: str = "nan"

    def __post_init__(self) -> None:
        check_bounds(self)


def test_numbers_of_numpy_become_those_of_python() -> None:
    settings = Settings(count=np.int64(2), share=np.float32(0.5))
    assert repr(settings) == repr(Settings(count=2, share=0.5))


def test_lists_become_tuples() -> None:
    settings = Settings(sizes=[3, 4], rows=[[1.0], [2.0]], pair=[3, 4], vector=[0, 0])
    other = Settings(sizes=(3, 4), rows=((1.0,), (2.0,)), pair=(3, 4), vector=(0.0, 0.0))
    assert hash(settings) == hash(other) and repr(settings) == repr(other)


@pytest.mark.parametrize(
    "wrong",
    [
        *({name: value} for name in ("share", "rate", "free", "limit") for value in (nan, inf)),
        *({"count": value} for value in (0, 1.5, "1", None, True) if value is not None),
        {"share": -0.1},
        {"share": 1.1},
        {"rate": 0.0},
        {"part_of_two": 2.0},
        {"limit": 0},
        {"sizes": (3, 0)},
        {"sizes": [3, nan]},
        {"sizes": ()},
        {"sizes": 3},
        {"vector": (0.4, -0.4)},
        *({"vector": value} for value in ((0.1,), [0.1] * 3, 0.1, ("a", "b"))),
        *({"pair": value} for value in ((1,), (1, 1.5), (1, None))),
        {"sizes": ((1,),)},
        {"rows": ((1.0, nan),)},
        {"count": 2**63},
        {"free": "x"},
    ],
    ids=str,
)
def test_a_number_out_of_bounds_is_refused_by_name_and_value(wrong: dict[str, Any]) -> None:
    ((name, value),) = wrong.items()
    with pytest.raises(ValueError, match=rf"^{name} = .*: must be ") as caught:
        Settings(**wrong)
    assert str(value) in str(caught.value)


def test_numbers_at_their_bounds_and_things_that_are_no_numbers_pass() -> None:
    Settings(count=1, share=0, rate=1e-300, free=-5, limit=None, sizes=[1], is_on=False)
    Settings(share=1, limit=3, vector=(0.3, -0.4))


def test_what_a_dataclass_holds_is_checked_with_it() -> None:
    part = Settings()
    object.__setattr__(part, "rate", nan)
    with pytest.raises(ValueError, match=r"^part\.rate = nan: must be finite, greater than 0$"):
        Settings(part=part)


def test_the_most_similar_word_is_suggested() -> None:
    assert suggest("learning_rat", ["gamma", "learning_rate"]) == "; did you mean 'learning_rate'?"
    assert suggest("xyz", ["gamma", "learning_rate"]) == ""
