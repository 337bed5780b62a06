"""A table of what a fish did and felt, for a spreadsheet or xarray."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from fishrl.envs import FlowEnv
from fishrl.envs.extensions import HasFlowLabels, HasHistory, HasScene, find_extension
from fishrl.envs.views import name_neuromasts
from fishrl.viewer.fields import CONVENTIONS, describe_unit

if TYPE_CHECKING:
    import xarray as xr

#: Units of columns by the last word of their names, where u_x and u_y are one; others are
#: velocities.
_UNITS = {
    "bl": "L", "bend": "L", "frequency": "1/T", "pressure": "rho L2/T2", "p": "rho L2/T2",
    "t": "T", "x": "L", "y": "L", "shear": "1/T",
}  # fmt: skip


def read_signals(env: FlowEnv) -> dict[str, Tensor]:
    """Return the present row of the table of B flows, ``[B]`` by name of the column.

    Columns: ``time_T``; nose ``x_bl``, ``y_bl``, from the lower left corner; ``heading_degrees``,
    counter-clockwise from +x; ``bend``, deflection of the tail in L, positive for a turn to the
    left; ``frequency``, beats per T. For each neuromast its place and its features, ``nose_x_bl``,
    ``right_1_pressure``, or ``mean_pressure`` of an average; units are those of ``LateralLine``.
    """
    task, solver = env.task, env.solver
    body, length = solver.body, task.scales.body_length
    nose = solver.markers()[:, 0] / length
    row = {
        "time_T": body.age / task.scales.period,
        "x_bl": nose[:, 0],
        "y_bl": nose[:, 1],
        "heading_degrees": torch.rad2deg(body.heading + body.internal_angle),
        "bend": -body.bend,
        "frequency": body.frequency * task.scales.period,
    }
    felt = find_extension(task, HasHistory).sense(solver, env.start).get("sensed")
    if felt is None:
        return row
    features = find_extension(task, HasFlowLabels).lateral_line_layout["features"]
    places = find_extension(task, HasScene).read_scene(solver, env.start)["neuromasts"] / length
    names = [name.replace(" ", "_") for name in name_neuromasts(places.shape[1])]
    for index, name in enumerate(names):
        row |= {f"{name}_x_bl": places[:, index, 0], f"{name}_y_bl": places[:, index, 1]}
    for index, name in enumerate(names if felt.shape[1] == len(names) else ["mean"]):
        row |= {f"{name}_{word}": felt[:, index, k] for k, word in enumerate(features)}
    return row


def make_table(columns: Mapping[str, Tensor], *, about: Mapping[str, str | float]) -> xr.Dataset:
    """Return columns ``[N]`` of ``read_signals`` over ``time``; ``about`` are its attributes."""
    import xarray as xr

    parts = {}
    for name, column in columns.items():
        words = name.replace("_", " ").removesuffix(" bl")
        unit = name.replace("u_", "u").rpartition("_")[2]
        notes = describe_unit(words, _UNITS.get(unit, "L/T"))
        if unit == "degrees":
            notes = {"units": "degree", "long_name": "heading, counter-clockwise from +x"}
        parts[name] = ("time", column.numpy(), notes)
    _, times, _ = parts.pop("time_T")
    axes = {"time": ("time", times, describe_unit("time", "T"))}
    return xr.Dataset(parts, coords=axes, attrs={**CONVENTIONS, **about})
