"""All cases, in the order of the report. A new case is a file and a line here."""

from importlib import import_module

from experiments.validation.case import Case

_MODULES = (
    "taylor_green",
    "poiseuille",
    "cavity",
    "invariance",
    "slip",
    "channel_cylinder",
    "free_cylinder",
    "d_cylinder",
    "outflow",
    "oscillating_cylinder",
    "settling_disc",
    "sheared_ellipse",
    "swimmer",
    "gaits",
    "turning",
    "compressibility",
    "stability",
)
CASES: tuple[Case, ...] = tuple(
    import_module(f"experiments.validation.{name}").CASE for name in _MODULES
)
