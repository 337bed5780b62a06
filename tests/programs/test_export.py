"""Flows written for other tools are read back by those tools."""

from pathlib import Path

import numpy as np
import pytest
import pyvista as pv
import xarray as xr

from fishrl.programs import export
from fishrl.training.progress import Progress
from fishrl.viewer.fields import write_netcdf, write_vtk, write_zarr

TINY = [
    "policy=pursuit", "compile=false", "periods=1", "frames_per_T=2", "task.body_length=16",
    "task.reynolds=300", "task.max_wall_speed=0.15", "task.wall_margin_bl=0.3",
    "task.domain_bl=[5.0,3.0]", "task.start_x_bl=[2.5,3.5]", "task.start_y_bl=[1.2,1.8]",
    "task.food_x_bl=1.0", "task.food_y_bl=1.5", "task.food_limits_bl=[1.0,2.0]",
]  # fmt: skip


@pytest.fixture(scope="module")
def flow() -> xr.Dataset:
    settings = export.main.read([*TINY, "save=x.nc"])
    return export.simulate(settings, progress=Progress(is_shown=False))


def test_fields_are_in_body_lengths_and_periods(flow: xr.Dataset) -> None:
    assert flow["time"].values == pytest.approx([0.0, 0.5, 1.0], abs=0.06)  # at a check
    assert flow["vorticity"].dims == ("time", "y", "x")
    assert flow["x"].values[-1] == pytest.approx(79 / 16)
    outline = flow["outline_0"].values
    assert np.ptp(outline[0], axis=0).max() == pytest.approx(1.0, abs=0.1)  # one L from end to end
    at_rest, beating = (np.abs(flow["u"].values[i]).max() for i in (0, -1))
    assert at_rest == pytest.approx(0.0, abs=1e-6)
    assert 0.1 < beating < 2.0


def test_xarray_reads_netcdf_and_zarr(flow: xr.Dataset, tmp_path: Path) -> None:
    write_netcdf(flow, tmp_path / "flow.nc")
    write_zarr(flow, tmp_path / "flow.zarr")
    for read in (
        xr.load_dataset(tmp_path / "flow.nc", engine="h5netcdf"),
        xr.open_zarr(tmp_path / "flow.zarr", consolidated=False).load(),
    ):
        xr.testing.assert_equal(read, flow)
        assert read["u"].attrs["units"] == "L/T"


def test_vtk_reads_the_flow_and_the_bodies(flow: xr.Dataset, tmp_path: Path) -> None:
    write_vtk(flow, tmp_path / "flow.pvd")
    reader = pv.get_reader(tmp_path / "flow.pvd")
    assert reader.time_values == pytest.approx(flow["time"].values.tolist())
    reader.set_active_time_value(reader.time_values[-1])
    image, fish = reader.read()
    last = flow.isel(time=-1)
    assert np.array_equal(image["vorticity"], last["vorticity"].values.ravel())
    assert np.allclose(image.points[:, 1].max(), last["y"].values[-1])
    assert np.allclose(fish.points[:, :2], last["outline_0"].values, atol=1e-6)
