"""Export of flow fields: NetCDF and Zarr for xarray, VTK for ParaView.

Needs the extra ``export``, whose packages are imported on use.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from math import nan
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.sax.saxutils import quoteattr

import numpy as np
from torch import Tensor

from fishrl.envs.views import read_patches
from fishrl.files import staged, write_whole
from fishrl.physics import InPlaceSolver, Scales, compute_pressure

if TYPE_CHECKING:
    import xarray as xr

CONVENTIONS = {"Conventions": "CF-1.11"}
#: Unit and description of each field.
FIELDS = {
    "u": ("L/T", "velocity along x"),
    "v": ("L/T", "velocity along y"),
    "p": ("rho L2/T2", "pressure above the pressure at rest"),
    "vorticity": ("1/T", "vorticity, positive counter-clockwise"),
}


def read_fields(solver: InPlaceSolver, scales: Scales) -> dict[str, Tensor]:
    """Return the current state of B flows in units of L and T, for ``make_dataset``.

    Returns:
        ``time`` ``[B]``, the fields of ``FIELDS`` ``[B, Y, X]``, NaN inside sharp skins,
        ``outline_0``, ``outline_1``, ... ``[B, N, 2]`` of the bodies, and ``patch_1``, ... ``[B, 4,
        2]`` of finer grids: outside these, values are linear between the nodes of coarser ones.
    """
    length, period = scales.body_length, scales.period
    rho, u = solver.macroscopic()
    water = solver.find_water()
    speed = length / period
    bodies = range(len(solver.bodies))
    fields = {
        "u": u[:, 0] / speed,
        "v": u[:, 1] / speed,
        "p": compute_pressure(rho) / speed**2,
        "vorticity": solver.vorticity(is_water=water) * period,
    }
    return {
        "time": solver.body.age / period,
        **{name: values.masked_fill(~water, nan) for name, values in fields.items()},
        **{f"outline_{body}": solver.markers(body) / length for body in bodies},
        **{name: corners / length for name, corners in read_patches(solver).items()},
    }


def make_dataset(
    series: Mapping[str, Tensor],
    *,
    body_length: float,
    about: Mapping[str, str | float] | None = None,
) -> xr.Dataset:
    """Return a time series of ``read_fields`` of one flow as a data set.

    Args:
        series: values ``[F, ...]`` by name, in order of time, such as ``Traces.of(0)``.
        body_length: L in nodes.
        about: further attributes of the data set.

    Returns:
        Fields ``(time, y, x)`` and closed outlines ``(time, marker, component)`` in L and T.
    """
    import xarray as xr

    values = {name: value.numpy() for name, value in series.items()}
    _, height, width = values["u"].shape
    axes = {
        "time": ("time", values.pop("time"), describe_unit("time", "T")),
        "y": ("y", np.arange(height) / body_length, describe_unit("y", "L") | {"axis": "Y"}),
        "x": ("x", np.arange(width) / body_length, describe_unit("x", "L") | {"axis": "X"}),
    }
    fields = {
        name: (("time", "y", "x"), values.pop(name), describe_unit(text, unit))
        for name, (unit, text) in FIELDS.items()
    }
    outlines = {}
    for name, value in values.items():
        what, points = "a body", name.replace("outline", "marker")
        if name.startswith("patch_"):
            what, points = "a finer grid", "corner"
        words = describe_unit(f"closed outline of {what}, (x, y)", "L")
        outlines[name] = (("time", points, "component"), value, words)
    attributes = {**CONVENTIONS, "nodes_per_L": body_length, **(about or {})}
    return xr.Dataset({**fields, **outlines}, coords=axes, attrs=attributes)


def describe_unit(text: str, unit: str) -> dict[str, str]:
    """Return CF attributes; the unit is part of the name, since CF reads L as litre, T as tesla."""
    return {"units": "1", "long_name": f"{text}, in {unit}"}


def _keep(flow: xr.Dataset) -> dict[Hashable, dict[str, Any]]:
    """Return the encoding of coordinates, for which CF allows no fill value."""
    return {name: {"_FillValue": None} for name in flow.coords}


def write_netcdf(flow: xr.Dataset, path: Path | str) -> None:
    """Write a data set of ``make_dataset`` as one compressed NetCDF file."""
    packing = {name: {"zlib": True, "complevel": 4} for name in flow.data_vars} | _keep(flow)
    with staged(Path(path)) as stage:
        flow.to_netcdf(stage, engine="h5netcdf", encoding=packing)


def write_zarr(flow: xr.Dataset, path: Path | str) -> None:
    """Write a data set of ``make_dataset`` as a Zarr folder with one chunk per time."""
    chunks = {name: {"chunks": (1, *flow[name].shape[1:])} for name in flow.data_vars} | _keep(flow)
    # consolidated metadata are specified for format 2 only
    flow.to_zarr(path, mode="w", encoding=chunks, consolidated=True, zarr_format=2)


def write_vtk(flow: xr.Dataset, path: Path | str) -> None:
    """Write flow and bodies at each time as VTK files, indexed by the ``.pvd`` file ``path``."""
    import pyvista as pv

    path = Path(path)
    folder = path.with_suffix("")
    folder.mkdir(parents=True, exist_ok=True)
    spacing = 1.0 / flow.attrs["nodes_per_L"]
    rows = []
    for index, time in enumerate(flow["time"].values):
        now = flow.isel(time=index)
        image = pv.ImageData(dimensions=(now.sizes["x"], now.sizes["y"], 1), spacing=(spacing,) * 3)
        for name in ("p", "vorticity"):
            image.point_data[name] = now[name].values.ravel()
        zeros = np.zeros(now["u"].size, np.float32)
        velocity = (now["u"].values.ravel(), now["v"].values.ravel(), zeros)
        image.point_data["velocity"] = np.stack(velocity, 1)
        parts: list[tuple[str, pv.DataSet]] = [(f"flow_{index:05d}.vti", image)]
        for name in (str(key) for key in now.data_vars if key not in FIELDS):
            points = np.pad(now[name].values, ((0, 0), (0, 1)))
            loop = [len(points) + 1, *range(len(points)), 0]
            line, face = pv.PolyData(points, lines=loop), pv.PolyData(points, faces=loop)
            parts.append((f"{name}_{index:05d}.vtp", line if name.startswith("patch_") else face))
        for part, (name, mesh) in enumerate(parts):
            mesh.save(folder / name)
            file = quoteattr(f"{folder.name}/{name}")
            rows.append(f'<DataSet timestep="{time:.6g}" part="{part}" file={file}/>')
    text = "\n".join(rows)
    head = '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1">\n'
    write_whole(path, f"{head}<Collection>\n{text}\n</Collection>\n</VTKFile>\n")


WRITERS = {".nc": write_netcdf, ".zarr": write_zarr, ".pvd": write_vtk}
