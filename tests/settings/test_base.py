"""Settings check the type and the bounds of each field, and convert only what is harmless."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from math import nan
from typing import Annotated, Any, Literal

import numpy as np
import pytest
from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt

from fishrl.envs import Predation
from fishrl.envs.streams import Stream
from fishrl.physics import Boundaries, Ellipse, Periodic
from fishrl.settings import REQUIRED, FieldErrors, Role, Settings, list_fields


class Part(Settings):
    size: PositiveInt = 1


class Whole(Settings):
    count: PositiveInt = 1
    free: float = 0.0
    sizes: tuple[PositiveInt, ...] = (1, 2)
    vector: tuple[float, float] = (0.0, 0.0)
    one_or_more: PositiveFloat | tuple[PositiveFloat, ...] = 1.0
    mode: Literal["burst", "cruise"] = "cruise"
    part: Part = Part(size=5)
    other: Any = None
    is_on: bool = True
    name: str = "nan"


@pytest.mark.parametrize(
    ("name", "value", "kept"),
    [
        ("count", np.int64(3), 3),
        ("free", np.float32(0.25), 0.25),
        ("free", -5, -5.0),
        ("sizes", [3, np.int32(4)], (3, 4)),
        ("vector", (0, 1), (0.0, 1.0)),
        ("is_on", np.bool_(False), False),
        ("name", "", ""),
    ],
)
def test_right_values_are_kept_with_python_types(name: str, value: Any, kept: Any) -> None:
    made = getattr(Whole(**{name: value}), name)
    assert made == kept and type(made) is type(kept)
    if isinstance(kept, tuple):
        assert list(map(type, made)) == list(map(type, kept))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Ellipse(24, 12), r"such as Ellipse\(length=24, width=12\)"),
        (lambda: Ellipse(angle=20), "InPlaceSolver.reset_ places it, heading in radians"),
        (lambda: Stream(speeds_bl=0.6), r"must be a list, such as \[0\.6\]"),
        (lambda: Predation(domain_bl=10), r"must be a list, such as \[10, 10\]"),
        (lambda: Boundaries(left="inlet"), r"OpenEdge\(\.\.\.\) or .*Periodic\(\.\.\.\)"),
        (lambda: Boundaries(left=Periodic), r"must be an object, such as Periodic\(\.\.\.\)"),
    ],
)
def test_an_error_says_how_to_write_it(call: Callable[[], Any], message: str) -> None:
    with pytest.raises((TypeError, ValueError), match=message):
        call()


def test_every_error_has_a_line() -> None:
    with pytest.raises(ValueError, match="must be") as caught:
        Whole(count=0, vector=(1,), mode="burs", free=nan, nme="x", part=None)  # type: ignore[arg-type, call-arg]
    assert set(str(caught.value).splitlines()) == {
        "count = 0: must be greater than 0",
        "vector = (1,): must be a list of 2",
        "mode = 'burs': must be 'burst' or 'cruise'; did you mean 'burst'?",
        "free = nan: must be finite",
        "nme: there is no such setting; did you mean 'name'?",
        "part = None: must be Part(...)",
    }


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


def test_changed_default_keeps_bounds_and_role() -> None:
    assert Derived(given=3).rate == 2.0 and Derived(given=3).part == Part(size=7)
    for kind, wrong in ((Derived, -1.0), (Narrowed, -1.0), (Narrowed, 1.0)):
        with pytest.raises(ValueError, match=r"^rate = .*: must be greater than or equal to"):
            kind(given=3, rate=wrong)
    rate, part, given = list_fields(Narrowed)
    assert rate == ("rate", float, 2.0, Role.EVALUATION)
    assert part == ("part", Part, Part(size=7), Role.RESULT)
    assert given == ("given", int, REQUIRED, Role.RESULT)


def test_unchecked_subclass_is_refused() -> None:
    with pytest.raises(TypeError, match="repeat its type"):

        class Untyped(Derived):
            rate = 3.0

    with pytest.raises(TypeError):

        @dataclass(frozen=True, kw_only=True)
        class Decorated(Derived):
            more: int = 3

    with pytest.raises(TypeError, match="abstract"):
        Base(given=3)  # type: ignore[abstract]


def test_checks_of_several_fields_keep_their_error() -> None:
    with pytest.raises(ValueError, match=r"^rate = 4.0: must be at most given = 3$") as caught:
        Derived(given=3, rate=4)
    assert not isinstance(caught.value, FieldErrors)
    with pytest.raises(ValueError, match=r"^given: has no default, so it must be given$"):
        Derived()  # type: ignore[call-arg]
