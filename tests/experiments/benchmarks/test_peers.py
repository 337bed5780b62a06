"""Other codes: each must damp a shear wave at its viscosity, or be left out."""

import numpy as np
import pytest

from experiments.benchmark import GROUPS
from experiments.benchmarks.measuring import BenchmarkSettings
from experiments.benchmarks.shear_wave import ShearWave

SETTINGS = BenchmarkSettings(body_length=80, threads=1)
MAKERS = {code: make for group, code, make in GROUPS if group == "peers"}
NUM_CASES = {"lbmpy": 7, "numba": 2, "lettuce": 2, "xlb": 1}


@pytest.mark.parametrize("value", [None, 0.0, float("nan")])
def test_a_wave_that_decays_otherwise_is_refused(value: float | None) -> None:
    wave = ShearWave(4, 100)
    after = wave.velocity() if value is None else np.full((100, 4), value)
    fields = iter((wave.velocity(), after))
    with pytest.raises(RuntimeError, match=r"-100\.0 % off" if value is None else "nan % off"):
        wave.check(lambda num_steps: None, lambda: next(fields))


@pytest.mark.slow
@pytest.mark.parametrize("package", NUM_CASES)
def test_an_installed_peer_damps_a_shear_wave_as_it_should(package: str) -> None:
    pytest.importorskip(package)
    cases = MAKERS[package](SETTINGS)  # checks its own viscosity
    assert len(cases) == NUM_CASES[package]
    for case in cases:
        case.advance(2)
        assert case.working_set > 36 * case.num_nodes
