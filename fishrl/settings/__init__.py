"""Settings: frozen dataclasses that check types and bounds, and their form in files.

The annotations of a subclass of ``Settings`` are its schema, which pydantic checks::

    class Swim(Settings):
        speed: Annotated[float, Field(gt=0)] = 1.0
        mode: Literal["burst", "cruise"] = "cruise"
        episodes: Annotated[PositiveInt, Role.EVALUATION] = 32

``build`` makes an object of plain nested data, as hydra composes it or a file stores it;
``describe`` is the inverse; ``list_fields`` lists what a class takes.
"""

from fishrl.settings.base import (
    REQUIRED,
    Entry,
    FieldErrors,
    Role,
    Settings,
    checked,
    find_role,
    list_fields,
)
from fishrl.settings.messages import suggest, unknown
from fishrl.settings.plain import TARGET, build, describe, flatten, to_plain

__all__ = [
    "REQUIRED",
    "TARGET",
    "Entry",
    "FieldErrors",
    "Role",
    "Settings",
    "build",
    "checked",
    "describe",
    "find_role",
    "flatten",
    "list_fields",
    "suggest",
    "to_plain",
    "unknown",
]
