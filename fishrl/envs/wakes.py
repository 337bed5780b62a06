"""Developed wakes as initial states of episodes: computed once and cached in a file.

A wake behind an obstacle takes about fifty D / U to develop, longer than many episodes. It is
therefore simulated once per stream speed without fish. When it is periodic, snapshots are taken at
equal intervals over one shedding period. At phase 0 the lift on the obstacle crosses its mean
upwards.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import torch
from pydantic import Field, PositiveFloat, PositiveInt
from torch import Tensor
from tqdm import trange

from fishrl.files import find_cache, load_tensors, staged
from fishrl.locks import take_lock
from fishrl.memory import check_memory
from fishrl.physics.bodies.motion import Fixed
from fishrl.physics.cache_key import hash_sources, make_key
from fishrl.physics.diagnostics import find_crossings, measure_cycles
from fishrl.physics.fast.identity import identify_for_file
from fishrl.physics.fast.solver import InPlaceSolver
from fishrl.physics.flow import FlowConfig
from fishrl.settings import Settings

logger = logging.getLogger(__name__)

_SAMPLES_PER_TRAVEL = 16  # of the lift; a shedding period is about five travels


class WakeRecipe(Settings):
    """Parameters of a bank of wakes. A *travel* is the time D / U.

    Args:
        config: the flow, with the obstacle as its only body.
        position: centre of the obstacle (x, y) in nodes.
        heading: heading of the obstacle, radians.
        speeds: stream speeds, nodes per step, one per flow.
        num_phases: snapshots per shedding period.
        num_travels: development time; the shedding frequency is measured in its second half.
    """

    config: FlowConfig
    position: tuple[float, float]
    heading: float
    speeds: Annotated[tuple[PositiveFloat, ...], Field(min_length=1)]
    num_phases: PositiveInt = 8
    num_travels: PositiveFloat = 100.0

    @property
    def key(self) -> str:
        """Key that changes with all that may change the wakes: recipe, physics, or this file."""
        foreign = identify_for_file(self.config)  # of classes from elsewhere
        return make_key(self, foreign, hash_sources(__name__), torch.__version__)


@dataclass(frozen=True, kw_only=True)
class WakeBank:
    """Developed wakes of n flows at K phases."""

    #: ``[n, K, Q, Y, X]`` of each grid, coarsest first, shifted by the weights, float32
    populations: Sequence[Tensor]
    shedding_frequencies: Tensor  #: ``[n]`` per step, from the zero crossings of the lift, float64
    _copies: dict[torch.device, list[Tensor]] = field(default_factory=dict, init=False, repr=False)

    def take(self, flow: Tensor, phase: Tensor) -> list[Tensor]:
        """Return the wakes of flows ``[N]`` at phases ``[N]`` in [0, 1), for ``set_populations_``.

        They are ``[N, Q, Y, X]`` of each grid, on the device of ``flow``, where the bank keeps a
        copy of itself from then on.
        """
        if flow.device not in self._copies:
            self._copies[flow.device] = [grid.to(flow.device) for grid in self.populations]
        bank = self._copies[flow.device]
        return [grid[flow, (phase * grid.shape[1]).long()] for grid in bank]


def find_file(recipe: WakeRecipe, folder: str | Path) -> Path:
    """Return the file of a recipe in ``folder``, or in the cache of this user.

    That is ``~/.cache/fishrl/wakes``, or in ``XDG_CACHE_HOME``. It is taken instead of a relative
    folder, which is another one in each working directory, unless the file is there already.
    """
    given = Path(folder).expanduser() / f"wakes-{recipe.key}.pt"
    cache = find_cache("wakes")
    if given.is_absolute() or given.is_file() or cache is None:
        return given
    return cache / given.name


def load_wakes(recipe: WakeRecipe, folder: str | Path) -> WakeBank:
    """Read the bank of a recipe from its file, see ``find_file``, or compute and store it."""
    path = find_file(recipe, folder)
    names = ("populations", "shedding_frequencies")
    if not path.is_file():
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.with_suffix(".lock").open("a") as file:
            take_lock(file, waits=True)
            if not path.is_file():  # else another process or thread has just developed them
                num = len(recipe.speeds)
                logger.warning("developing %d wake(s), once, for a few minutes: %s", num, path)
                bank = develop_wakes(recipe)
                with staged(path) as stage:
                    torch.save({name: getattr(bank, name) for name in names}, stage)
                size = sum(file.stat().st_size for file in path.parent.glob("wakes-*.pt"))
                logger.info(
                    "%s holds %.2g GB of wakes; delete what you like", path.parent, size / 1e9
                )
    return WakeBank(**load_tensors(path, what="wakes", remedy="delete the file"))


def develop_wakes(recipe: WakeRecipe, *, compile: bool = True) -> WakeBank:
    """Simulate each flow until its wake is periodic, and take snapshots of one period.

    Raises:
        ValueError: if too few vortices are shed to measure the frequency, or a flow diverges.
    """
    config, (body,) = recipe.config, recipe.config.bodies
    check_memory(wakes=len(recipe.speeds) * recipe.num_phases * config.num_bytes)
    size, fastest = body.size, max(recipe.speeds)
    kick = Fixed(kick_speed=0.3 * fastest, kick_steps=round(3.0 * size / fastest))
    config = replace(config, bodies=(replace(body, motion=kick),), stream_speed=fastest)
    solver = InPlaceSolver(config=config, num_envs=1, compile=compile, num_workers=0)
    wakes: list[list[Tensor]] = []
    frequencies: list[float] = []
    for speed in recipe.speeds:
        snapshots, frequency = _develop(solver, recipe, speed)
        wakes.append(snapshots)
        frequencies.append(frequency)
        logger.info("wake %d: Strouhal %.4f", len(wakes), frequency * size / speed)
    solver.close()
    return WakeBank(
        populations=[torch.stack(grid) for grid in zip(*wakes, strict=True)],
        shedding_frequencies=torch.tensor(frequencies, dtype=torch.float64),
    )


def _develop(solver: InPlaceSolver, recipe: WakeRecipe, speed: float) -> tuple[list[Tensor], float]:
    """Return the snapshots ``[K, Q, Y, X]`` of one flow's grids and its frequency per step."""
    travel, unit = solver.config.bodies[0].size / speed, 2 * solver.config.coarsest_spacing
    solver.set_stream_speed_(torch.tensor([speed], dtype=torch.float64))
    solver.reset_(
        torch.ones(1, dtype=torch.bool),
        torch.tensor([recipe.position], dtype=torch.float64),
        torch.tensor([recipe.heading], dtype=torch.float64),
        velocity=(1.0, 0.0),
    )
    interval = unit * max(1, round(travel / _SAMPLES_PER_TRAVEL / unit))
    num = round(0.5 * recipe.num_travels * travel / interval)
    impulses: list[Sequence[float]] = [solver.body.impulse[0].tolist()]
    for _ in trange(2 * num, desc=f"wake at {speed:.4f}", leave=False, disable=None):
        solver.advance_(interval)
        impulses.append(solver.body.impulse[0].tolist())
    lift = torch.tensor(impulses, dtype=torch.float64)[:, 1].diff()[num:] / interval
    if solver.is_diverged().any():
        raise ValueError(
            f"the wake at {speed:.4f} nodes per step diverged: lower max_wall_speed or the "
            "Reynolds number, or raise body_length"
        )
    try:
        cycles = measure_cycles(lift, interval)
    except ValueError as error:
        raise ValueError(
            f"the wake at {speed:.4f} nodes per step sheds too few vortices within num_travels = "
            f"{recipe.num_travels:g} D / U ({error}): raise it"
        ) from error
    period = 1.0 / cycles.frequency
    # a sample is the mean over the preceding interval, so its time is half an interval earlier
    last = (len(lift) - 0.5 - float(find_crossings(lift - cycles.mean)[-1])) * interval
    begin = period * -(-last // period) - last
    snapshots, now, num_grids = [], 0, len(solver.config.list_grids())
    for k in range(recipe.num_phases):
        target = unit * round((begin + k * period / recipe.num_phases) / unit)
        solver.advance_(target - now)
        now = target
        snapshots.append([solver.populations(grid)[0].cpu() for grid in range(num_grids)])
    return [torch.stack(grid) for grid in zip(*snapshots, strict=True)], cycles.frequency
