"""Write the flow around a policy's fish for other tools: ``python -m experiments.export ...``.

``checkpoint=runs/<name> save=flow.nc`` simulates one episode and writes velocity, pressure and
vorticity over time, and the outlines of all bodies, in body lengths L and tail-beat periods T.
The ending of ``save`` says how: ``.nc`` NetCDF and ``.zarr`` Zarr, both read by xarray, ``.pvd``
VTK files for ParaView. Needs the extra ``export``.
"""

from __future__ import annotations

import math
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from omegaconf import MISSING
from torch import Tensor

from experiments.program import program
from experiments.train_settings import PolicySettings, read_task
from fishrl.bounds import bounded
from fishrl.envs import FlowEnv, make_env, run_episodes
from fishrl.extras import show_install
from fishrl.physics.diagnostics import compute_pressure, compute_vorticity
from fishrl.training.evaluation import fixed_starts
from fishrl.training.progress import Progress
from fishrl.viewer import check_folder

if TYPE_CHECKING:
    import xarray as xr

#: Unit and description of what is written.
FIELDS = {
    "u": ("L/T", "velocity along x"),
    "v": ("L/T", "velocity along y"),
    "p": ("rho L2/T2", "pressure above that of the fluid at rest"),
    "vorticity": ("1/T", "vorticity, positive counter-clockwise"),
}


@dataclass(frozen=True, kw_only=True)
class ExportSettings(PolicySettings):
    """Settings of an export.

    Args:
        save: file or folder to write, ending in ``.nc``, ``.zarr`` or ``.pvd``.
        periods: T after which the episode is cut; ``null`` runs it to its end.
        frames_per_T: moments per period, approximately.
    """

    save: str = MISSING
    periods: float | None = bounded(5.0, greater=0)
    frames_per_T: int = bounded(8, least=1)

    def __post_init__(self) -> None:
        """Check that the format is known, too."""
        super().__post_init__()
        if Path(self.save).suffix not in WRITERS:
            raise ValueError(f"save = {self.save}: must end in one of {', '.join(WRITERS)}")


def simulate(settings: ExportSettings, *, progress: Progress) -> xr.Dataset:
    """Run one episode and return its fields ``(time, y, x)`` and outlines ``(time, marker)``."""
    task, recognition, policy = settings.make_policy()
    cut = math.inf if settings.periods is None else settings.periods / task.interval_T
    max_decisions = math.ceil(min(task.time_limit, cut) - 1e-9)
    stride = max(1, round(task.checks_per_action / task.interval_T / settings.frames_per_T))
    frames: list[dict[str, Any]] = []
    num_checks = 0

    def read(flows: FlowEnv) -> None:
        frames.append(read_frame(flows))

    def count(running: Tensor, flows: FlowEnv) -> None:
        nonlocal num_checks
        num_checks += 1
        if num_checks % stride == 0:
            read(flows)

    progress.rename("compilation" if settings.compile else "set-up")
    env = make_env(
        task=task,
        recognition=recognition,
        num_envs=1,
        seed=settings.seed,
        device=settings.device,
        compile=settings.compile,
        frames_per_action=task.checks_per_action,
    )
    with closing(env):
        progress.start("episode", total=max_decisions)
        run_episodes(
            env,
            policy,
            fixed_starts(task, 1, seed=settings.seed),
            max_decisions=max_decisions,
            on_begin=lambda begun, state: read(env.base_env),
            on_step=lambda running, step: progress.advance(1),
            on_frame=count,
        )
    return make_dataset(frames, body_length=task.scales.body_length)


def read_frame(flows: FlowEnv) -> dict[str, Any]:
    """Return time, fields and outlines of the first row, in L and T."""
    solver, scales = flows.solver, flows.task.scales
    length, period = scales.body_length, scales.period
    rho, u = (values[:1] for values in solver.macroscopic())
    speed = length / period
    fields = {
        "u": u[0, 0] / speed,
        "v": u[0, 1] / speed,
        "p": compute_pressure(rho)[0] / speed**2,
        "vorticity": compute_vorticity(u)[0] * period,
    }
    outlines = [solver.markers(index)[0] / length for index in range(len(solver.bodies))]
    return {
        "time": float(solver.body.age[0]) / period,
        "fields": {name: field.cpu().numpy().astype(np.float32) for name, field in fields.items()},
        "outlines": [outline.cpu().numpy() for outline in outlines],
    }


def make_dataset(frames: list[dict[str, Any]], *, body_length: float) -> xr.Dataset:
    """Return frames on one time axis."""
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


def write_netcdf(flow: xr.Dataset, path: Path) -> None:
    """Write one compressed NetCDF file."""
    packing = {name: {"zlib": True, "complevel": 4} for name in flow.data_vars}
    flow.to_netcdf(path, engine="h5netcdf", encoding=packing)


def write_zarr(flow: xr.Dataset, path: Path) -> None:
    """Write a Zarr folder, one chunk per moment."""
    chunks = {name: {"chunks": (1, *flow[name].shape[1:])} for name in flow.data_vars}
    flow.to_zarr(path, mode="w", encoding=chunks, consolidated=False)


def write_vtk(flow: xr.Dataset, path: Path) -> None:
    """Write an image of the flow and the bodies of each moment, and ``path`` as their index."""
    import pyvista as pv

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


@program(ExportSettings, groups={"task": "predation", "preset": None}, stored=read_task)
def main(settings: ExportSettings) -> None:
    """Simulate and write."""
    path = Path(settings.save).expanduser()
    check_folder(path)
    try:
        import pyvista  # noqa: F401
        import xarray  # noqa: F401
    except ImportError as error:
        raise ImportError(f"exports need packages: {show_install('export')}") from error
    with Progress() as progress:
        flow = simulate(settings, progress=progress)
    WRITERS[path.suffix](flow, path)
    print(f"written to {path}: {flow.sizes['time']} moments, {flow.nbytes / 1e6:.0f} MB in memory")


if __name__ == "__main__":
    main()
