"""Settings check the type and the bounds of each field, and convert only what is harmless."""

from __future__ import annotations

import copy
import pickle
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import inf, nan
from typing import Annotated, Any, Literal, Optional

import numpy as np
import pytest
import torch
from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt

from fishrl.settings import REQUIRED, FieldErrors, Role, Settings, list_fields

Point = tuple[int, float]  # a name that contains that of a type
Vector = tuple[float, float]


class Part(Settings):
    size: PositiveInt = 1
    names: tuple[str, ...] = ("a", "b")


class Whole(Settings):
    count: PositiveInt = 1
    share: Annotated[float, Field(ge=0, le=1)] = 0.5
    part_of_two: Annotated[float, Field(gt=0, lt=2)] = 1.0
    free: float = 0.0
    limit: PositiveFloat | None = None
    start: float = 0.0
    old_style: Optional[int] = None  # noqa: UP045
    sizes: Annotated[tuple[PositiveInt, ...], Field(min_length=1)] = (1, 2)
    place: Point = (0, 0.0)
    vector: Vector = (0.0, 0.0)
    pair: tuple[int, int] | None = None
    rows: tuple[tuple[PositiveFloat, ...], ...] = ((1.0,),)
    one_or_more: PositiveFloat | tuple[PositiveFloat, ...] = 1.0
    mode: Literal["burst", "cruise"] = "cruise"
    part: Part = Part(size=5)
    parts: tuple[Part, ...] = ()
    tensor: torch.Tensor | None = None
    other: Any = None
    further: Mapping[str, Any] = field(default_factory=dict)
    is_on: bool = True
    name: str = "nan"

    @cached_property
    def doubled(self) -> float:
        return 2 * self.free


RIGHT: dict[str, list[Any]] = {
    "count": [1, 7, 2**63 - 1, np.int64(3)],
    "share": [0, 1, 0.5, np.float32(0.25)],
    "part_of_two": [1e-300, 1.99],
    "free": [-5, 1e300, np.float64(2)],
    "limit": [None, 3, 0.1],
    "start": [0.5],
    "old_style": [None, -3],
    "sizes": [(1,), [3, 4], (np.int32(5),)],
    "place": [(1, 0.5), [1, 2]],
    "vector": [(0, 1), [0.5, -0.5]],
    "pair": [None, (1, 2), [3, 4]],
    "rows": [[[1.0], [2, 3]], ()],
    "one_or_more": [2, [1, 2], (0.5,)],
    "mode": ["burst"],
    "part": [Part()],
    "parts": [[Part(), Part(size=2)]],
    "tensor": [None, torch.zeros(2)],
    "other": [None, "x", 3],
    "further": [{"a": [1]}],
    "is_on": [False, np.bool_(True)],
    "name": ["", "x"],
}
WRONG: dict[str, list[Any]] = {
    "count": [0, 1.0, 1.5, "1", None, True, 2**63, nan, (1,)],
    "share": [-0.1, 1.1, nan, True, "0.5", None],
    "part_of_two": [0, 2, 2.0],
    "free": [nan, inf, -inf, "x", None, 2**70, (1.0,)],
    "limit": [0, nan, inf, "1", False],
    "start": [nan, "1"],
    "old_style": [1.5, "1", True],
    "sizes": [(3, 0), [3, nan], (), 3, ((1,),), None, {1, 2}, "12", np.ones(2, int)],
    "place": [(1.5, 0), (1,), (1, 2, 3), 3, (1, None)],
    "vector": [(0.1,), [0.1] * 3, 0.1, ("a", "b"), (nan, 0)],
    "pair": [(1,), (1, 1.5), (1, None), 1],
    "rows": [((1.0, nan),), ((0.0,),), (1.0,)],
    "one_or_more": [0, -1.0, (1, 0), "x", None],
    "mode": ["burs", None, 3],
    "part": [None, {"size": 1}, 3, "Part"],
    "parts": [(Part(), 3), Part()],
    "tensor": [3, [1.0]],
    "other": [nan, (1, inf), [2**64]],
    "further": [3, "a"],
    "is_on": [1, 0, "true", None],
    "name": [3, None, True],
}


def freeze(value: Any) -> Any:
    return tuple(map(freeze, value)) if isinstance(value, list | tuple) else value


@pytest.mark.parametrize("name", RIGHT)
def test_right_values_are_kept_with_python_types(name: str) -> None:
    for value in RIGHT[name]:
        made = Whole(**{name: value})
        for settings in (made, replace(made)):
            kept = getattr(settings, name)
            assert not isinstance(kept, list | np.generic)
            assert kept is value or kept == freeze(value)


@pytest.mark.parametrize("name", WRONG)
def test_wrong_values_are_refused_by_name_and_value(name: str) -> None:
    for value in WRONG[name]:
        with pytest.raises(FieldErrors, match=rf"^{name} = .*: must be ") as caught:
            Whole(**{name: value})
        assert "\n" not in str(caught.value)
        with pytest.raises(ValueError, match="must be"):
            replace(Whole(), **{name: value})


def test_every_error_has_a_line() -> None:
    with pytest.raises(ValueError, match="must be") as caught:
        Whole(count=0, vector=(1,), mode="burs", free=nan, nme="x", part=None)  # type: ignore[arg-type, call-arg]
    assert set(str(caught.value).splitlines()) == {
        "count = 0: must be greater than 0",
        "vector = (1,): must be a list of 2",
        "mode = 'burs': must be 'burst' or 'cruise'; did you mean 'burst'?",
        "free = nan: must be finite",
        "nme: there is no such setting; did you mean 'name'?",
        "part = None: must be of type Part",
    }


def test_what_fits_neither_of_two_types_is_told_both() -> None:
    with pytest.raises(ValueError, match=r"^one_or_more = 'x': must be a number or a list$"):
        Whole(one_or_more="x")  # type: ignore[arg-type]


def test_equal_settings_have_the_same_hash_and_text() -> None:
    class Small(Settings):
        sizes: tuple[float, ...] = (1.0,)

    listed, tupled = Small(sizes=[1, 2]), Small(sizes=(1.0, 2.0))  # type: ignore[arg-type]
    assert (hash(listed), repr(listed)) == (hash(tupled), repr(tupled))


def test_settings_are_frozen_keyword_only_and_can_be_copied() -> None:
    whole = Whole(free=3)
    assert whole.doubled == 6.0
    with pytest.raises(AttributeError):
        whole.free = 4.0  # type: ignore[misc]
    with pytest.raises(TypeError):
        Whole(3)  # type: ignore[misc]
    for copied in (copy.deepcopy(whole), pickle.loads(pickle.dumps(whole))):
        assert copied == whole and copied.doubled == 6.0


class Base(Settings, ABC):
    rate: Annotated[NonNegativeFloat, Role.EVALUATION] = 1.0
    part: Part = Part(size=5)
    given: int

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.rate > self.given:
            raise ValueError(f"rate = {self.rate}: must be at most given = {self.given}")

    @abstractmethod
    def act(self) -> None: ...


class Derived(Base):
    rate: float = 2.0
    part: Part = field(default_factory=lambda: Part(size=7))

    def act(self) -> None: ...


class Narrowed(Derived):
    rate: Annotated[float, Field(ge=1.5)] = 2.0


def test_a_subclass_that_changes_a_default_keeps_bounds_and_role() -> None:
    assert Derived(given=3).rate == 2.0 and Derived(given=3).part == Part(size=7)
    for kind, wrong in ((Derived, -1.0), (Narrowed, -1.0), (Narrowed, 1.0)):
        with pytest.raises(ValueError, match=r"^rate = .*: must be at least"):
            kind(given=3, rate=wrong)
    entry = list_fields(Narrowed)[0]
    assert entry == ("rate", float, 2.0, Role.EVALUATION)


def test_a_subclass_that_would_not_be_checked_cannot_be_made() -> None:
    with pytest.raises(TypeError, match="repeat its type"):

        class Untyped(Derived):
            rate = 3.0

    with pytest.raises(TypeError):

        @dataclass(frozen=True, kw_only=True)
        class Decorated(Derived):
            more: int = 3

    with pytest.raises(TypeError, match="abstract"):
        Base(given=3)  # type: ignore[abstract]


def test_checks_of_several_fields_raise_their_own_error() -> None:
    with pytest.raises(ValueError, match=r"^rate = 4.0: must be at most given = 3$") as caught:
        Derived(given=3, rate=4)
    assert not isinstance(caught.value, FieldErrors)
    with pytest.raises(ValueError, match=r"^given: has no default, so it must be given$"):
        Derived()  # type: ignore[call-arg]


def test_fields_are_listed_with_type_default_and_role() -> None:
    entries = {entry.name: entry for entry in list_fields(Derived)}
    assert list(entries) == ["rate", "part", "given"]
    assert entries["given"].default is REQUIRED
    assert entries["part"].default == Part(size=7) and entries["part"].type is Part
    assert entries["part"].role is Role.RESULT


def test_constructors_of_other_classes_are_listed_too() -> None:
    class Plain:
        def __init__(self, *, size: int, names: tuple[str, ...] = ()) -> None: ...

    entries = list_fields(Plain)
    assert [(e.name, e.type, e.default) for e in entries] == [
        ("size", int, REQUIRED),
        ("names", tuple[str, ...], ()),
    ]
