"""Other codes: each must damp a shear wave at its viscosity, or be left out."""

import sys
from collections.abc import Callable, Sequence

import numpy as np
import pytest

from experiments.benchmarks.comparison import BenchmarkSettings, Case
from experiments.benchmarks.peers import lbmpy_kernels, lettuce_step, numba_kernel, xlb_step
from experiments.benchmarks.peers.shear_wave import ShearWave

SETTINGS = BenchmarkSettings(body_length=80, threads=1)
PEERS = [
    ("lbmpy", lbmpy_kernels.make_cases, 7),
    ("numba", numba_kernel.make_cases, 2),
    ("lettuce", lettuce_step.make_cases, 2),
    ("xlb", xlb_step.make_cases, 1),
]


@pytest.mark.parametrize("value", [None, 0.0, float("nan")])
def test_a_wave_that_decays_otherwise_is_refused(value: float | None) -> None:
    wave = ShearWave(4, 100)
    after = wave.velocity() if value is None else np.full((100, 4), value)
    fields = iter((wave.velocity(), after))
    with pytest.raises(RuntimeError, match=r"-100\.0 % off" if value is None else "inf % off"):
        wave.check(lambda num_steps: None, lambda: next(fields))


@pytest.mark.slow
@pytest.mark.parametrize(("package", "make", "num_cases"), PEERS)
def test_an_installed_peer_damps_a_shear_wave_as_it_should(
    package: str, make: Callable[[BenchmarkSettings], Sequence[Case]], num_cases: int
) -> None:
    pytest.importorskip(package)
    cases = make(SETTINGS)  # checks its own viscosity
    assert len(cases) == num_cases
    for case in cases:
        case.advance(2)
        assert case.working_set > 36 * case.num_nodes


@pytest.mark.parametrize(("package", "make", "num_cases"), PEERS)
def test_an_absent_peer_is_missed_as_a_module(
    package: str,
    make: Callable[[BenchmarkSettings], Sequence[Case]],
    num_cases: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, package, None)  # as if it were not installed
    with pytest.raises(ModuleNotFoundError, match=r"No module named|halted"):
        make(SETTINGS)
