"""Write the flow around a policy's fish for other tools: ``fishrl export ...``.

``checkpoint=runs/<name> save=flow.nc`` simulates one episode and writes velocity, pressure and
vorticity over time, and the outlines of all bodies, in body lengths L and tail-beat periods T.
The ending of ``save`` says how: ``.nc`` NetCDF and ``.zarr`` Zarr, both read by xarray, ``.pvd``
VTK files for ParaView. Needs the extra ``export``.
"""

import json
from contextlib import closing
from itertools import count, pairwise
from math import floor
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import PositiveFloat, PositiveInt
from tensordict import TensorDictBase
from torch import Tensor

from fishrl import __version__
from fishrl.envs.episodes import count_decisions, run_episodes
from fishrl.extras import show_install
from fishrl.programs.export_policy import read_revision
from fishrl.programs.policy_settings import PolicySettings, read_task
from fishrl.programs.program import program
from fishrl.settings import describe
from fishrl.training.callback import SILENT, Callback
from fishrl.training.evaluation import fixed_starts
from fishrl.training.progress import Progress
from fishrl.viewer import check_folder
from fishrl.viewer.fields import WRITERS, make_dataset, read_fields

if TYPE_CHECKING:
    import xarray as xr


class ExportSettings(PolicySettings):
    """Settings of an export.

    Args:
        save: file or folder to write, ending in ``.nc``, ``.zarr`` or ``.pvd``.
        periods: T after which the episode is cut; ``null`` runs it to its end.
        frames_per_T: frames per period, approximately.
    """

    save: str
    periods: PositiveFloat | None = 5.0
    frames_per_T: PositiveInt = 8

    def __post_init__(self) -> None:
        """Check that the format is known, too."""
        super().__post_init__()
        if Path(self.save).suffix not in WRITERS:
            raise ValueError(f"save = {self.save}: must end in one of {', '.join(WRITERS)}")


def simulate(settings: ExportSettings, *, progress: Callback = SILENT) -> "xr.Dataset":
    """Run one episode and return its fields ``(time, y, x)`` and outlines ``(time, marker)``."""
    task, recognition, policy = settings.make_policy()
    max_decisions = min(task.time_limit, count_decisions(task, settings.periods))
    share = min(1.0, settings.frames_per_T * task.interval_T / task.checks_per_action)  # of checks
    written = (floor(check * share + 1e-9) for check in count(0))
    is_due = (before < now for before, now in pairwise(written))
    env = settings.make_env(task, recognition, num_envs=1, progress=progress)

    def read(start_of: Tensor, what: object) -> dict[str, Tensor]:
        return read_fields(env.base_env.solver, task.scales)

    def end(start_of: Tensor, step: TensorDictBase) -> dict[str, Tensor]:
        progress.on_progress(1)
        return read(start_of, step) if step["next", "done"].all() else {}

    with closing(env):
        progress.on_phase("episode", total=max_decisions)
        episodes = run_episodes(
            env,
            policy,
            fixed_starts(task, 1, seed=settings.seed),
            max_decisions=max_decisions,
            on_begin=read,
            on_step=end,
            on_frame=lambda start_of, flows: read(start_of, flows) if next(is_due) else {},
        )
    name = settings.policy or Path(str(settings.checkpoint)).resolve().name
    commit = read_revision() or "unknown"
    return make_dataset(
        episodes.traces.of(0),
        body_length=task.scales.body_length,
        about={  # names of the CF conventions, where there are any
            "title": f"{type(task).__name__}, policy {name}, seed {settings.seed}",
            "source": f"fishrl {__version__}, commit {commit}",
            "comment": "lengths in body lengths L, times in periods T, pressure in rho (L/T)^2",
            "policy": name,
            "seed": settings.seed,
            "commit": commit,
            "task": json.dumps(describe(task)),
            "reynolds": task.reynolds,
            "mach": task.scales.mach,
            "steps_per_T": task.scales.period,
        },
    )


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
