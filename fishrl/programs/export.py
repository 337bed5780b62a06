"""Write the flow around a policy's fish for other tools: ``fishrl export ...``.

``policy=runs/<name> save=flow.nc`` simulates one episode and writes velocity, pressure and
vorticity over time, and the outlines of all bodies, in body lengths L and tail-beat periods T.
The ending of ``save`` says how: ``.nc`` NetCDF and ``.zarr`` Zarr, both read by xarray, ``.pvd``
VTK files for ParaView; these need the extra ``export``. ``.csv``, and ``.nc`` with
``signals=true``, is a table of what the fish did and felt, of
``fishrl.viewer.signals.read_signals``.
"""

import json
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from importlib.util import find_spec
from itertools import count, pairwise
from math import floor
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import PositiveFloat, PositiveInt
from tensordict import TensorDictBase
from torch import Tensor

from fishrl import __version__
from fishrl.envs import AbstractTask, FlowEnv
from fishrl.envs.episodes import count_decisions, run_episodes
from fishrl.extras import show_install
from fishrl.files import claim_file
from fishrl.pages import write_csv
from fishrl.programs.export_policy import read_revision
from fishrl.programs.program import ending_in, program
from fishrl.programs.stored_task import POLICY
from fishrl.settings import describe
from fishrl.training.callback import SILENT, Callback
from fishrl.training.evaluation import fixed_starts
from fishrl.training.policies import evaluate, prepare
from fishrl.training.progress import Progress
from fishrl.viewer.fields import WRITERS, make_dataset, read_fields, write_netcdf
from fishrl.viewer.signals import make_table, read_signals

if TYPE_CHECKING:
    import xarray as xr


TABLE = ".csv"
#: What is imported to write a file, by its ending.
PACKAGES = {
    ".nc": ("xarray", "h5netcdf"),
    ".zarr": ("xarray", "zarr"),
    ".pvd": ("xarray", "pyvista"),
}


def record(
    read: Callable[[FlowEnv], dict[str, Tensor]],
    *,
    periods: float | None,
    frames_per_T: int,
    callback: Callback = SILENT,
    **given: Any,
) -> tuple[dict[str, Tensor], AbstractTask]:
    """Run one episode and return the series ``[F, ...]`` of what is read, and the task.

    ``read`` returns values ``[B, ...]`` by name, the time first; other arguments are those of
    ``main`` and ``evaluate``.
    """
    given["flows"] = replace(given["flows"], num_envs=1)
    env, policy = prepare(**given, callback=callback)
    task, seed = env.base_env.task, given["seed"]
    max_decisions = min(task.time_limit, count_decisions(task, periods))
    share = min(1.0, frames_per_T * task.interval_T / task.checks_per_action)  # of checks
    written = (floor(check * share + 1e-9) for check in count(0))
    is_due = (before < now for before, now in pairwise(written))

    def begin(start_of: Tensor, what: object) -> dict[str, Tensor]:
        return read(env.base_env)

    def end(start_of: Tensor, step: TensorDictBase) -> dict[str, Tensor]:
        callback.on_progress(1)
        return read(env.base_env) if step["next", "done"].all() else {}

    with closing(env):
        callback.on_phase("episode", total=max_decisions)
        episodes = run_episodes(
            env,
            policy,
            fixed_starts(task, 1, seed=seed),
            max_decisions=max_decisions,
            on_begin=begin,
            on_step=end,
            on_frame=lambda start_of, flows: read(flows) if next(is_due) else {},
        )
    series = episodes.traces.of(0)
    times = next(iter(series.values()))  # an end may have been read at a check, too
    is_new = times.diff(prepend=times[:1] - 1.0) > 0.0
    return {name: values[is_new] for name, values in series.items()}, task


def simulate(**given: Any) -> "xr.Dataset":
    """Run one episode and return its fields ``(time, y, x)`` and outlines ``(time, marker)``.

    Arguments are those of ``record``.
    """
    series, task = record(lambda env: read_fields(env.solver, env.task.scales), **given)
    about = describe_episode(task, policy=given["policy"], seed=given["seed"])
    return make_dataset(series, body_length=task.scales.body_length, about=about)


def describe_episode(task: AbstractTask, *, policy: str, seed: int) -> dict[str, str | float]:
    """Return attributes of a data set, named as in the CF conventions where these have names."""
    name, commit = Path(policy).name, read_revision() or "unknown"
    return {
        "title": f"{type(task).__name__}, policy {name}, seed {seed}",
        "source": f"fishrl {__version__}, commit {commit}",
        "comment": "lengths in body lengths L, times in periods T, pressure in rho (L/T)^2",
        "policy": name,
        "seed": seed,
        "commit": commit,
        "task": json.dumps(describe(task)),
        "reynolds": task.reynolds,
        "mach": task.scales.mach,
        "steps_per_T": task.scales.period,
    }


@program(evaluate, **POLICY | {"without": ("callbacks", "episodes")})
def main(
    *,
    save: Annotated[str, ending_in(*WRITERS, TABLE)],
    periods: PositiveFloat | None = 5.0,
    frames_per_T: PositiveInt = 8,
    signals: bool = False,
    preset: str | None = None,
    **given: Any,
) -> None:
    """Simulate an episode and write its fields, or its table.

    Args:
        save: file or folder to write, ending in ``.nc``, ``.zarr``, ``.pvd`` or ``.csv``.
        periods: T after which the episode is cut; ``null`` runs it to its end.
        frames_per_T: frames per period, approximately.
        signals: write the table to a ``.nc``, too, rather than the fields.
        preset: name of a preset; only its task is used.
        **given: arguments of ``evaluate``.
    """
    given |= {"periods": periods, "frames_per_T": frames_per_T}
    path = Path(save).expanduser()
    missing = [name for name in PACKAGES.get(path.suffix, ()) if find_spec(name) is None]
    if missing:
        raise ImportError(f"{save} needs {', '.join(missing)}: {show_install('export')}")
    if signals and path.suffix not in (TABLE, ".nc"):
        raise ValueError(f"save = {save}: the table is a .csv or .nc; leave out signals for fields")
    with claim_file(path), Progress() as progress:
        if signals or path.suffix == TABLE:
            columns, task = record(read_signals, callback=progress, **given)
            if path.suffix == TABLE:
                rows = zip(*(column.tolist() for column in columns.values()), strict=True)
                write_csv(path, [*columns], ([f"{x:.6g}" for x in row] for row in rows))
            else:
                about = describe_episode(task, policy=given["policy"], seed=given["seed"])
                write_netcdf(make_table(columns, about=about), path)
            said = f"{len(columns)} columns"
        else:
            flow = simulate(callback=progress, **given)
            WRITERS[path.suffix](flow, path)
            said = f"{flow.sizes['time']} moments, {flow.nbytes / 1e6:.0f} MB in memory"
    print(f"written to {path}: {said}")
