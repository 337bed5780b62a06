"""Flows and transitions written for other tools are read back by those tools; uploads fail well.

The tools are imported where they are used: every process of a run of tests imports this file.
"""

import csv
import json
import socket
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.path import Path as Polygon
from torchrl.data.datasets.minari_data import MinariExperienceReplay

from fishrl.envs import Flows, KarmanGait, make_env
from fishrl.envs.control import Bend
from fishrl.envs.lateral_line import LateralLine
from fishrl.programs import export, export_data
from fishrl.programs.export_policy import send
from fishrl.viewer.fields import write_netcdf, write_vtk, write_zarr
from fishrl.viewer.signals import make_table, read_signals
from fishrl.zoo import find_policy
from tests.envs.conftest import SMALL

TINY = [
    "policy=pursuit", "flows.compile=false", "periods=1", "frames_per_T=2", "task.body_length=16",
    "task.levels=1", "task.reynolds=300", "task.max_wall_speed=0.15", "task.wall_margin_bl=0.3",
    "task.domain_bl=[5.0,3.0]", "task.start_x_bl=[2.5,3.5]", "task.start_y_bl=[1.2,1.8]",
    "task.food_x_bl=1.0", "task.food_y_bl=1.5", "task.food_limits_bl=[1.0,2.0]",
]  # fmt: skip
NOT_SIMULATED = ("save", "preset", "signals")


@pytest.fixture(scope="module")
def flow() -> Any:
    given = vars(export.main.read([*TINY, "save=x.nc"]))
    return export.simulate(**{n: v for n, v in given.items() if n not in NOT_SIMULATED})


def test_fields_are_in_body_lengths_and_periods(flow: Any) -> None:
    assert flow["time"].values == pytest.approx([0.0, 0.5, 1.0], abs=0.06)  # at a check
    assert flow["time"].values[-1] == pytest.approx(1.0, abs=1e-9)  # the end, whole periods later
    assert flow["vorticity"].dims == ("time", "y", "x")
    assert flow["x"].values[-1] == pytest.approx(79 / 16)
    outline = flow["outline_0"].values
    assert np.ptp(outline[0], axis=0).max() == pytest.approx(1.0, abs=0.1)  # one L from end to end
    at_rest, beating = (np.nanmax(np.abs(flow["u"].values[i])) for i in (0, -1))
    assert at_rest == pytest.approx(0.0, abs=1e-6)
    assert 0.1 < beating < 2.0


def test_fields_hold_no_number_inside_a_sharp_skin(flow: Any) -> None:
    """Nodes inside, found by another library: 0.08 L^2, 21 nodes; at first some lie on the skin."""
    x, y = np.meshgrid(flow["x"].values, flow["y"].values)
    nodes = np.stack((x.ravel(), y.ravel()), 1)
    for index in range(1, flow.sizes["time"]):
        now = flow.isel(time=index)
        inside = Polygon(now["outline_0"].values).contains_points(nodes).reshape(x.shape)
        assert 14 < inside.sum() < 28
        for name in ("u", "v", "p", "vorticity"):
            assert np.array_equal(np.isnan(now[name].values), inside)


@pytest.mark.filterwarnings("error")  # of metadata that is not consolidated
def test_xarray_reads_netcdf_and_zarr(flow: Any, tmp_path: Path) -> None:
    import xarray as xr

    write_netcdf(flow, tmp_path / "flow.nc")
    write_zarr(flow, tmp_path / "flow.zarr")
    with xr.open_dataset(tmp_path / "flow.nc", engine="h5netcdf", mask_and_scale=False) as raw:
        assert not any("_FillValue" in raw[name].attrs for name in raw.coords)
    for read in (
        xr.load_dataset(tmp_path / "flow.nc", engine="h5netcdf"),
        xr.open_zarr(tmp_path / "flow.zarr").load(),
    ):
        xr.testing.assert_identical(read, flow)
        assert read.attrs["Conventions"] == "CF-1.11"
        assert {part.attrs["units"] for part in read.variables.values()} == {"1"}
        assert read["u"].attrs["long_name"] == "velocity along x, in L/T"
        task = json.loads(read.attrs["task"])
        assert read.attrs["nodes_per_L"] == task["body_length"] == 16
        assert read.attrs["reynolds"] == task["reynolds"]
        assert read.attrs["steps_per_T"] > 1 and "pursuit" in read.attrs["title"]
        assert (read.attrs["policy"], read.attrs["seed"]) == ("pursuit", 0)
        assert read.attrs["commit"] in read.attrs["source"]


@pytest.mark.usefixtures("kinematic")
def test_table_has_a_line_per_moment_and_columns_of_each_neuromast(tmp_path: Path) -> None:
    import xarray as xr

    path = tmp_path / "signals.csv"
    words = ["policy=pid", "task=station-line-quick-v1", "periods=1", "frames_per_T=4"]
    export.main.run(export.main.read([*words, "flows.compile=false", f"save={path}"]))
    with path.open(encoding="utf-8") as file:
        lines = [{k: float(v) for k, v in line.items()} for line in csv.DictReader(file)]
    times = [line["time_T"] for line in lines]
    assert times == sorted(set(times)) and len(times) >= 5 and times[0] == 0.0
    names = ["nose", "right_1", "left_1", "right_2", "left_2"]
    parts = ("x_bl", "y_bl", "ahead", "left", "pressure")
    own = {"time_T", "x_bl", "y_bl", "heading_degrees", "bend", "frequency"}
    assert lines[0].keys() == own | {f"{name}_{part}" for name in names for part in parts}
    for line in lines:
        assert abs(line["nose_x_bl"] - line["x_bl"]) < 0.15  # two nodes from the skin, of 20
        assert abs(sum(line[f"{name}_pressure"] for name in names)) < 1e-4  # deviations
    export.main.run(
        export.main.read(
            [*words, "flows.compile=false", f"save={path.with_suffix('.nc')}", "signals=true"]
        )
    )
    with xr.open_dataset(path.with_suffix(".nc"), engine="h5netcdf") as read:
        assert set(read.variables) == (lines[0].keys() - {"time_T"}) | {"time"}
        assert read["time"].values == pytest.approx(times, rel=1e-5)
        for name in ("heading_degrees", "left_2_pressure"):
            assert read[name].values == pytest.approx([line[name] for line in lines], rel=1e-5)
        assert read["heading_degrees"].attrs["units"] == "degree"
        assert read["left_2_pressure"].attrs["long_name"] == "left 2 pressure, in rho L2/T2"
        assert read.attrs["Conventions"] == "CF-1.11" and read.attrs["policy"] == "pid"


@pytest.mark.usefixtures("kinematic")
def test_signals_have_their_units_and_sign() -> None:
    line = LateralLine(features=("x", "u_x", "u_y", "p"), is_averaged=True)
    task = KarmanGait(**SMALL, lateral_line=line, control=Bend(bend_bl=0.05))
    env = make_env(task=task, flows=Flows(num_envs=1, compile=False))
    env.reset()
    env.base_env.solver.body.bend.fill_(-0.05)  # the tail is on the left
    row = read_signals(env.base_env)
    assert float(row["bend"]) == pytest.approx(0.05)
    table = make_table(row, about={})
    names = ("bend", "frequency", "nose_y_bl", "mean_x", "mean_u_x", "mean_u_y", "mean_p")
    units = [table[name].attrs["long_name"].rpartition("in ")[2] for name in names]
    assert units == ["L", "1/T", "L", "L", "L/T", "L/T", "rho L2/T2"]


def test_vtk_reads_the_flow_and_the_bodies(flow: Any, tmp_path: Path) -> None:
    import pyvista as pv

    path = tmp_path / """R&D "é" <x='1'>.pvd"""
    write_vtk(flow, path)
    reader = pv.get_reader(path)
    assert reader.time_values == pytest.approx(flow["time"].values.tolist())
    reader.set_active_time_value(reader.time_values[-1])
    image, fish = reader.read()
    last = flow.isel(time=-1)
    assert np.array_equal(image["vorticity"], last["vorticity"].values.ravel(), equal_nan=True)
    assert np.allclose(image.points[:, 1].max(), last["y"].values[-1])
    assert np.allclose(fish.points[:, :2], last["outline_0"].values, atol=1e-6)


def test_exports_hold_the_outlines_of_finer_grids(tmp_path: Path) -> None:
    import pyvista as pv

    changed = {
        "save": "x.nc",
        "periods": "0.2",
        "task.levels": "2",
        "task.checks_per_action": "5",
        "task.domain_bl": "[6.0,5.0]",
        "task.food_limits_bl": "[1.0,4.0]",
        "task.start_y_bl": "[2.2,2.8]",
    }
    words = [word for word in TINY if word.partition("=")[0] not in changed]
    words += [f"{key}={value}" for key, value in changed.items()]
    given = vars(export.main.read(words))
    flow = export.simulate(**{n: v for n, v in given.items() if n not in NOT_SIMULATED})
    last, path = flow.isel(time=-1), tmp_path / "flow.pvd"
    (low, _, high, _), outline = last["patch_1"].values, last["outline_0"].values
    assert (outline > low).all() and (outline < high).all()
    assert flow["patch_1"].dims == ("time", "corner", "component")
    assert np.isnan(last["vorticity"].values).any()
    write_vtk(flow, path)
    _, fish, patch = pv.get_reader(path).read()
    assert patch.n_lines == 1 and fish.n_cells == 1 and fish.n_lines == 0


@pytest.mark.usefixtures("kinematic")
def test_minari_reads_the_transitions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import minari

    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    tiny = [words for words in TINY if not words.startswith(("periods", "frames_per_T"))]
    settings = export_data.main.read(
        [*tiny, "name=fishrl/pursuit-v0", "episodes=3", "flows.num_envs=2", f"folder={tmp_path}",
         "task.time_limit=4"]
    )  # fmt: skip
    export_data.main.run(settings)
    data = minari.load_dataset("fishrl/pursuit-v0")
    assert [path.name for path in tmp_path.iterdir()] == ["fishrl"]
    assert (tmp_path / "fishrl" / "namespace_metadata.json").is_file()
    episodes = list(data.iterate_episodes())
    assert len(episodes) == 3
    for episode in episodes:
        num = len(episode.actions)
        assert 1 <= num <= 4 and data.observation_space["observation"].dtype == np.float32
        assert len(episode.observations["observation"]) == len(episode.infos["captured"]) == num + 1
        assert len(episode.infos["reward_approach"]) == num + 1
        masks = episode.observations["action_mask"][:-1]
        assert masks[np.arange(num), episode.actions].all()  # only legal actions
        over = episode.terminations | episode.truncations
        assert over[-1] and not over[:-1].any()
    replayed = MinariExperienceReplay(
        "fishrl/pursuit-v0", batch_size=None, load_from_local_minari=True, root=tmp_path / "torchrl"
    )
    assert len(replayed) == sum(len(episode.actions) for episode in episodes)
    assert replayed.metadata["observation_space"]["action_mask"].shape == (3,)


@pytest.mark.usefixtures("kinematic")
def test_failed_dataset_can_be_written_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ["policy=random", "flows.compile=false", "flows.num_envs=1", "episodes=1"]
    words += ["task=predation-quick-v1", "task.time_limit=1", f"folder={tmp_path}", "name=fish-v0"]

    with pytest.raises(ValueError, match="name = fish: give a version"):
        export_data.main.run(export_data.main.read([*words[:-1], "name=fish"]))

    def fail(*_: Any) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("minari.utils.MinariDataset", fail)
        with pytest.raises(KeyboardInterrupt):
            export_data.main.run(export_data.main.read(words))
    export_data.main.run(export_data.main.read(words))
    assert [path.name for path in tmp_path.iterdir()] == ["fish-v0"]


def test_unreachable_hub_is_one_line_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    with socket.create_server(("127.0.0.1", 0)) as closed:
        port = closed.getsockname()[1]
    monkeypatch.setattr("huggingface_hub.constants.ENDPOINT", f"http://127.0.0.1:{port}")
    with pytest.raises(OSError, match=r"^upload = me/fish: .*refused$"):
        send(find_policy("predation_sharp"), "me/fish")
