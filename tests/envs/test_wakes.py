"""Developed wakes: frequency, phases, keys and files."""

import importlib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from math import pi
from pathlib import Path
from time import sleep
from types import SimpleNamespace

import pytest
import torch

from fishrl.envs.wakes import WakeBank, WakeRecipe, develop_wakes, find_file, load_wakes
from fishrl.physics import DCylinder, FlowConfig, InPlaceSolver
from fishrl.physics.boundaries import Boundaries, NonEquilibrium, OpenEdge
from fishrl.physics.collision import compute_macroscopic

SPEED = 0.16  # nodes per step
STREAM = NonEquilibrium(velocity=(1.0, 0.0))
#: A half disc of 8 nodes at Re 100: far too coarse to trust, fast enough to test with.
RECIPE = WakeRecipe(
    config=FlowConfig(
        width=72,
        height=48,
        tau=0.5 + 3.0 * SPEED * 8 / 100,
        stream_speed=SPEED,
        bodies=(DCylinder(diameter=8.0),),
        boundaries=Boundaries(left=STREAM, right=OpenEdge(), bottom=STREAM, top=STREAM),
    ),
    position=(16.3, 23.5),
    heading=pi,
    speeds=(SPEED,),
    num_phases=4,
    num_travels=24.0,
)


@pytest.fixture(scope="module")
def bank() -> WakeBank:
    torch.set_num_threads(1)
    return develop_wakes(RECIPE, compile=False)


def test_shedding_frequency_is_plausible(bank: WakeBank) -> None:
    """Strouhal numbers of half discs lie at 0.15 to 0.27, see the validation page."""
    assert [f.shape for f in bank.populations] == [(1, 4, 9, 48, 72)]
    assert 0.15 < bank.shedding_frequencies.item() * 8 / SPEED < 0.27


def test_snapshots_are_equal_parts_of_a_period_apart(bank: WakeBank) -> None:
    """A quarter of a period on, each snapshot has become the next, and the last the first."""
    config = RECIPE.config
    solver = InPlaceSolver(config=config, num_envs=4, compile=False)
    solver.reset_(
        torch.ones(4, dtype=torch.bool),
        torch.tensor(RECIPE.position).expand(4, 2),
        torch.full((4,), pi),
    )
    phase = torch.arange(4) / 4.0
    solver.set_populations_(bank.take(torch.zeros(4, dtype=torch.int64), phase))
    solver.advance_(2 * round(0.125 / bank.shedding_frequencies.item()))
    behind = (slice(None), slice(None), slice(8, 40), slice(24, 60))
    after, snapshots = solver.populations()[behind], bank.populations[0][0][behind]
    error = (after[:, None] - snapshots[None]).square().mean((-1, -2, -3)).sqrt()
    assert error.argmin(1).tolist() == [1, 2, 3, 0]
    assert (error.amin(1) < 0.15 * error.amax(1)).all()


@pytest.mark.parametrize("levels", [1, 2])
def test_each_wake_has_its_own_speed(levels: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """One solver develops them all; vortices are left out, to save time."""
    speeds, frequencies = (SPEED, 0.10), iter((0.02, 0.05))
    shed = lambda *_: SimpleNamespace(frequency=next(frequencies), mean=0.0)  # noqa: E731
    monkeypatch.setattr("fishrl.envs.wakes.measure_cycles", shed)
    monkeypatch.setattr("fishrl.envs.wakes.find_crossings", lambda _: [0.0])
    config = replace(RECIPE.config, width=73, height=49, levels=levels)
    short = replace(RECIPE, config=config, speeds=speeds, num_phases=2, num_travels=1.0)
    bank = develop_wakes(short, compile=False)
    assert bank.shedding_frequencies.tolist() == [0.02, 0.05]
    grids = [(2, 2, 9, height, width) for width, height, _ in config.list_grids()]
    assert [f.shape for f in bank.populations] == grids
    inflow = compute_macroscopic(bank.populations[0].unbind(2)).ux[..., 0]
    for measured, speed in zip(inflow, speeds, strict=True):
        torch.testing.assert_close(measured, torch.full_like(measured, speed), rtol=1e-4, atol=0)


def test_wake_without_vortices_is_refused() -> None:
    with pytest.raises(ValueError, match="sheds too few vortices"):
        develop_wakes(replace(RECIPE, num_travels=4.0), compile=False)


def test_wake_is_made_once(bank: WakeBank, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, made = tmp_path / f"wakes-{RECIPE.key}.pt", list[str]()

    def develop(_: WakeRecipe) -> WakeBank:
        made.append("wake")
        sleep(0.5)
        return bank

    monkeypatch.setattr("fishrl.envs.wakes.develop_wakes", develop)
    with ThreadPoolExecutor(4) as pool:
        banks = list(pool.map(lambda _: load_wakes(RECIPE, tmp_path), range(4)))
    assert made == ["wake"] and path.is_file()
    assert all(torch.equal(each.populations[0], bank.populations[0]) for each in banks)


OWN = """
from fishrl.physics.boundaries import NonEquilibrium
GAIN = 1.0
class Gusty(NonEquilibrium):
    def compute_edge(self, *given):
        return GAIN
"""


def test_wakes_of_own_classes_are_kept_by_their_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Those of a class of a function are not for other processes."""
    (tmp_path / "own_inflow.py").write_text(OWN)
    monkeypatch.syspath_prepend(str(tmp_path))
    own = importlib.import_module("own_inflow")

    def find_key(edge: NonEquilibrium) -> str:
        edges = replace(RECIPE.config.boundaries, left=edge)
        return replace(RECIPE, config=replace(RECIPE.config, boundaries=edges)).key

    keys = [find_key(own.Gusty(velocity=(1.0, 0.0)))]
    own.GAIN = 2.0
    keys.append(find_key(own.Gusty(velocity=(1.0, 0.0))))

    class Local(NonEquilibrium):
        pass

    keys.append(find_key(Local(velocity=(1.0, 0.0))))
    assert find_key(Local(velocity=(1.0, 0.0))) == keys[-1]
    monkeypatch.setattr("fishrl.physics.fast.identity._PROCESS", "another")
    keys.append(find_key(Local(velocity=(1.0, 0.0))))
    assert len(set(keys)) == 4


def test_cache_is_the_users_in_any_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    name = f"wakes-{RECIPE.key}.pt"
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    for folder in ("a", "b"):
        (tmp_path / folder / "runs").mkdir(parents=True)
        monkeypatch.chdir(tmp_path / folder)
        assert find_file(RECIPE, "runs") == tmp_path / "cache/fishrl/wakes" / name
    assert find_file(RECIPE, tmp_path / "own") == tmp_path / "own" / name
    (tmp_path / "b/runs" / name).touch()
    assert find_file(RECIPE, "runs") == Path("runs") / name
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setattr("os.path.expanduser", lambda path: path)  # of a user without a home
    assert find_file(RECIPE, "other") == Path("other") / name


def test_key_follows_the_recipe() -> None:
    body, tau = (DCylinder(diameter=9.0),), {"tau": 0.53}
    same = replace(RECIPE, config=replace(RECIPE.config, bodies=(DCylinder(diameter=8.0),)))
    assert same.key == RECIPE.key
    configs = [replace(RECIPE.config, **change) for change in (tau, {"bodies": body})]
    others = [replace(RECIPE, **change) for change in ({"speeds": (0.11,)}, {"num_phases": 5})]
    others += [replace(RECIPE, config=config) for config in configs]
    assert len({RECIPE.key, *(other.key for other in others)}) == 5


def test_diverged_wake_is_refused_with_a_remedy() -> None:
    config = replace(RECIPE.config, tau=0.501)
    thin = replace(RECIPE, config=config, speeds=(0.3,), num_travels=10.0)
    with pytest.raises(ValueError, match=r"the wake at 0.3000 nodes per step diverged: lower"):
        develop_wakes(thin, compile=False)
