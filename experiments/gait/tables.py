"""Tables of the Kármán gait."""

from collections.abc import Mapping, Sequence
from math import nan
from typing import Any

from experiments.gait.diagnostics import BALANCE
from fishrl.pages import write_table
from fishrl.programs.statistics import show

#: Columns of each table: heading, entry of ``diagnose``, format.
STATION = (
    ("episodes", "episodes", ".0f"),
    ("diverged", "diverged", ".0f"),
    ("survival, T", "survival_T", ".1f"),
    ("lasted", "survivors", ".0%"),
    ("label correct", "named_right", ".1%"),
    ("x, L", "x_mean", ".2f"),
    ("beat / shedding", "frequency_over_shedding", ".2f"),
    ("in street", "in_street", ".0%"),
    ("in gait", "in_gait", ".0%"),
)
MOTION = (
    ("angle mean, °", "angle_mean", ".1f"),
    ("max, °", "angle_max", ".1f"),
    ("phase lock", "phase_lock", ".2f"),
    ("work per T: muscles", "work", ".3f"),
    ("pushing", "positive_work", ".3f"),
    ("torque", "torque_work", ".3f"),
    ("sum", "total_work", ".3f"),
    ("lateral", "lateral_work", ".3f"),
)
HELD_HEADS = ("stream, L/T", "beats per T", "drift, L/T", "held")
WORK_HEADS = (
    *("stream, L/T", "muscles, wake", "free", "ratio", "saved", "pushing, wake", "free", "ratio"),
    *("torque, wake", "free", "sum, wake", "free"),
    *("lateral (paper's form), wake", "free", "ratio"),
)

#: Results of each arm per flow, as ``diagnose`` or ``combine_seeds`` returns them.
Results = Mapping[str, Sequence[Mapping[str, float]]]


def write_results(results: Results, speeds: Sequence[float]) -> str:
    """Return Markdown tables of station and motion, a row per arm and flow.

    ``speeds`` are those of the flows, L / T. The heading is held by an external torque: its work
    and the net work of the muscles add up to what the water receives.
    """
    tables = []
    for columns in (STATION, MOTION):
        rows = []
        for name, flows in results.items():
            for speed, flow in zip(speeds, flows, strict=True):
                errors = {"survival_T": flow["survival_error_T"]}
                cells = (show(flow[key], form, errors.get(key, nan)) for _, key, form in columns)
                rows.append([name, f"{speed:g}", *cells])
        heads = ["policy", "stream, L/T", *(head for head, _, _ in columns)]
        tables.append(write_table(heads, rows))
    return "\n".join(tables)


def divide_work(still: Mapping[str, float], wake: Mapping[str, float], name: str) -> float:
    """Return the work in a free stream over that in the wake; NaN unless both are positive."""
    return still[name] / wake[name] if min(still[name], wake[name]) > 0.0 else nan


def write_free_stream(
    free: Mapping[str, Any], in_wake: Sequence[Mapping[str, float]], speeds: Sequence[float]
) -> str:
    """Return Markdown tables of free streams, and of their work over that in the wake.

    ``free`` is as ``hold_in_free_stream`` returns, ``in_wake`` as ``diagnose`` per flow.
    """
    forms = (("frequency", ".2f"), ("drift", "+.4f"))
    held, rows = [], []
    for speed, wake, still in zip(speeds, in_wake, free["flows"], strict=True):
        count = f"{still['held']} of {still['episodes']}"
        held.append([f"{speed:g}", *(show(still[name], form) for name, form in forms), count])
        pairs = {name: ((wake[name], ".3f"), (still[name], ".2f")) for name in BALANCE}
        ratios = {name: divide_work(still, wake, name) for name in BALANCE}
        cells = (
            *(*pairs["work"], (ratios["work"], ".1f"), (1.0 - 1.0 / ratios["work"], ".1%")),
            *(*pairs["positive_work"], (ratios["positive_work"], ".1f")),
            *(*pairs["torque_work"], *pairs["total_work"]),
            *(*pairs["lateral_work"], (ratios["lateral_work"], ".1f")),
        )
        rows.append([f"{speed:g}", *(show(value, form) for value, form in cells)])
    scales = f"Free stream: T = {free['steps_per_T']} steps, Mach {free['mach']:.2f}."
    return f"{write_table(HELD_HEADS, held)}\n{write_table(WORK_HEADS, rows)}\n{scales}\n"
