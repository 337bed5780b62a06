"""Every settings class of fishrl refuses odd values in one line, and survives files and copies."""

import copy
import math
import pickle
import typing
from contextlib import suppress
from dataclasses import replace
from importlib import import_module
from inspect import isabstract
from pkgutil import walk_packages
from typing import Any

import pytest
from pydantic import ConfigDict, TypeAdapter, ValidationError

import fishrl
from fishrl.envs import Predation
from fishrl.physics.bodies.strokes import C_START
from fishrl.settings import REQUIRED, FieldErrors, Settings, build, describe, list_fields
from fishrl.training.algorithms.discrete_sac import DiscreteSAC
from fishrl.training.logger import CsvLogger

ODD: tuple[Any, ...] = (
    *(None, True, False, 0, 1, -1, 2, 7, 100, 2**31, 2**63, -(2**64)),
    *(0.0, 0.5, 1.5, -0.5, 1e9, math.nan, math.inf, -math.inf),
    *("", "x", "1", "cpu", b"x", (), (1,), [1, 2], (0.5, 1.5), [0.5, 1.5, 2.0], ("a", "b")),
    *((1, math.nan), (None, 1), ((1.0, 2.0), (3.0, 4.0)), {"a": 1}, {1, 2}, object()),
)
#: Values of fields, where those that fit their annotations one by one do not make sense.
GIVEN: dict[str, dict[str, Any]] = {
    "NonEquilibrium": {"density": 1.0},
    "Plan": {"task": Predation()},
    "TrainConfig": {"task": Predation(), "algorithm": DiscreteSAC(), "logger": CsvLogger()},
    "Strokes": {"sequence": C_START.sequence},
    "FlowConfig": {"width": 64, "height": 48, "tau": 0.6},
    "Gait": {"amplitude": 0.1, "envelope": (0.3, 0.1, 0.6), "wavenumber": 6.0},
    "Scales": {"body_length": 32, "reynolds": 500.0, "period": 1000},
}


def list_settings() -> list[type[Settings]]:
    names = [module.name for module in walk_packages(fishrl.__path__, "fishrl.")]
    modules = [import_module(n) for n in names]
    found = {
        f"{module.__name__}.{name}": kind
        for module in modules
        for name, kind in vars(module).items()
        if isinstance(kind, type) and issubclass(kind, Settings) and kind is not Settings
        if kind.__module__ == module.__name__ and not isabstract(kind)
    }
    return [found[name] for name in sorted(found)]


KINDS = list_settings()
assert {"FlowConfig", "Predation", "DiscreteSAC", "Plan"} <= {kind.__name__ for kind in KINDS}


def make_values(kind: type[Settings]) -> dict[str, Any]:
    """Return values of the fields that have no default."""
    values: dict[str, Any] = {}
    for base in kind.__mro__:
        values |= GIVEN.get(base.__name__, {})
    for name, hint, default, _ in list_fields(kind):
        if default is REQUIRED and name not in values:
            values[name] = make_one(hint, kind.__pydantic_fields__[name].metadata)
    return values


def make_one(hint: Any, metadata: Any = ()) -> Any:
    """Return the first value of some that fits an annotation."""
    for known in KINDS:
        if isinstance(hint, type) and issubclass(known, hint) and known.__name__ != "Plan":
            return known(**make_values(known))
    adapter = TypeAdapter(
        typing.Annotated[hint, *metadata, None],
        config=ConfigDict(arbitrary_types_allowed=True, strict=True),
    )
    for value in (20, 20.0, 1, 0.5, "a", (1.0,), (1.0, 1.0), (0.5, 1.0), (1.0, 1.0, 1.0)):
        with suppress(ValidationError):
            return adapter.validate_python(value)
    raise AssertionError(f"no value of {hint}")


def try_to_make(kind: type[Settings], **values: Any) -> Settings | FieldErrors:
    try:
        return kind(**values)
    except FieldErrors as error:
        return error


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_odd_value_kept_or_refused(kind: type[Settings], monkeypatch: pytest.MonkeyPatch) -> None:
    values = make_values(kind)
    monkeypatch.setattr(kind, "__post_init__", lambda _: None)
    for name, hint, _, _ in list_fields(kind):
        for value in ODD:
            made = try_to_make(kind, **{**values, name: value})
            if isinstance(made, FieldErrors):
                assert str(made).startswith(f"{name} = ") and ": must " in str(made)
                assert "\n" not in str(made)
            else:
                kept = getattr(made, name)
                assert kept == (tuple(value) if isinstance(value, list) else value)
                assert hint is not float or type(kept) is float


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_settings_survive_files_copies_and_processes(kind: type[Settings]) -> None:
    made = kind(**make_values(kind))
    copies = (replace(made), build(kind, describe(made)), copy.deepcopy(made))
    for same in (*copies, pickle.loads(pickle.dumps(made))):
        assert type(same) is kind and describe(same) == describe(made)
        if not hasattr(made, "logger"):  # which equals no other
            assert same == made and hash(same) == hash(made)
