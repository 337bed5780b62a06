"""Flow fields for other tools: NetCDF and Zarr, which xarray reads, and VTK for ParaView.

Needs the extra ``export``, which is imported on use.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fishrl.physics import InPlaceSolver, Scales, compute_pressure, compute_vorticity

if TYPE_CHECKING:
    import xarray as xr

#: Unit and description of what is written.
FIELDS = {
    "u": ("L/T", "velocity along x"),
    "v": ("L/T", "velocity along y"),
    "p": ("rho L2/T2", "pressure above that of the fluid at rest"),
    "vorticity": ("1/T", "vorticity, positive counter-clockwise"),
}


def read_fields(solver: InPlaceSolver, scales: Scales, *, row: int = 0) -> dict[str, Any]:
    """Return the fields and outlines of a flow at this moment, for ``make_dataset``.

    Args:
        solver: with one body or more.
        scales: L and T of what is returned.
        row: which flow of the batch.
    """
    length, period = scales.body_length, scales.period
    rho, u = (values[row : row + 1] for values in solver.macroscopic())
    speed = length / period
    fields = {
        "u": u[0, 0] / speed,
        "v": u[0, 1] / speed,
        "p": compute_pressure(rho)[0] / speed**2,
        "vorticity": compute_vorticity(u)[0] * period,
    }
    outlines = [solver.markers(index)[row] / length for index in range(len(solver.bodies))]
    return {
        "time": float(solver.body.age[row]) / period,
        "fields": {name: field.cpu().numpy().astype(np.float32) for name, field in fields.items()},
        "outlines": [outline.cpu().numpy() for outline in outlines],
    }


def make_dataset(frames: list[dict[str, Any]], *, body_length: float) -> xr.Dataset:
    """Return what ``read_fields`` gave at several moments, on one time axis.

    Args:
        frames: of one flow, in order.
        body_length: L in nodes.

    Returns:
        Fields ``(time, y, x)`` and closed outlines ``(time, marker, component)`` in L and T.
    """
    import xarray as xr

    height, width = frames[0]["fields"]["u"].shape
    axes = {
        "time": ("time", [frame["time"] for frame in frames], {"units": "T"}),
        "y": ("y", np.arange(height) / body_length, {"units": "L"}),
        "x": ("x", np.arange(width) / body_length, {"units": "L"}),
    }
    fields = {
        name: (
            ("time", "y", "x"),
            np.stack([frame["fields"][name] for frame in frames]),
            {"units": unit, "long_name": text},
        )
        for name, (unit, text) in FIELDS.items()
    }
    outlines = {
        f"outline_{body}": (
            ("time", f"marker_{body}", "component"),
            np.stack([frame["outlines"][body] for frame in frames]),
            {"units": "L", "long_name": "closed outline of a body, (x, y)"},
        )
        for body in range(len(frames[0]["outlines"]))
    }
    return xr.Dataset({**fields, **outlines}, coords=axes, attrs={"nodes_per_L": body_length})


def write_netcdf(flow: xr.Dataset, path: Path | str) -> None:
    """Write one compressed NetCDF file."""
    packing = {name: {"zlib": True, "complevel": 4} for name in flow.data_vars}
    flow.to_netcdf(path, engine="h5netcdf", encoding=packing)


def write_zarr(flow: xr.Dataset, path: Path | str) -> None:
    """Write a Zarr folder, one chunk per moment."""
    chunks = {name: {"chunks": (1, *flow[name].shape[1:])} for name in flow.data_vars}
    flow.to_zarr(path, mode="w", encoding=chunks, consolidated=False)


def write_vtk(flow: xr.Dataset, path: Path | str) -> None:
    """Write an image of the flow and the bodies of each moment, and ``path`` as their index."""
    import pyvista as pv

    path = Path(path)
    folder = path.with_suffix("")
    folder.mkdir(exist_ok=True)
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
        for name in filter(lambda key: key.startswith("outline_"), map(str, now.data_vars)):
            points = np.pad(now[name].values, ((0, 0), (0, 1)))
            face = pv.PolyData(points, faces=[len(points), *range(len(points))])
            parts.append((f"{name}_{index:05d}.vtp", face))
        for part, (name, mesh) in enumerate(parts):
            mesh.save(folder / name)
            rows.append(
                f'<DataSet timestep="{time:.6g}" part="{part}" file="{folder.name}/{name}"/>'
            )
    text = "\n".join(rows)
    path.write_text(
        '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1">\n'
        f"<Collection>\n{text}\n</Collection>\n</VTKFile>\n"
    )


WRITERS = {".nc": write_netcdf, ".zarr": write_zarr, ".pvd": write_vtk}
