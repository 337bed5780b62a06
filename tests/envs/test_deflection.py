"""A fish held in place sheds a straight wake at slow beats and a deflected one at fast beats.

Known of foils: Godoy-Diana et al. 2009, J. Fluid Mech. 622, 23. It is why fish lean that hold a
station in a slow stream.
"""

from dataclasses import replace
from math import pi

import pytest
import torch

from fishrl.envs import KarmanGait
from fishrl.envs.streams import Stream
from fishrl.physics import Driven, InPlaceSolver


@pytest.mark.slow
@pytest.mark.compile
def test_fast_beats_deflect_the_wake() -> None:
    """Two beats per body length of stream do, one and a half do not; Re_f = 500, 1 L/T."""
    stream = Stream(has_disc=False)
    task = KarmanGait(body_length=20, max_wall_speed=0.15, domain_bl=(8.0, 4.0), stream=stream)
    config, period, unit = task.flow_config(), task.scales.period, task.scales.reference_speed
    config = replace(config, stream_speed=unit, bodies=(replace(task.fish, motion=Driven()),))
    beats = torch.tensor([1.5, 2.0]).double()
    solver = InPlaceSolver(config=config, num_envs=2, frequency=beats / period, num_workers=0)
    middle = torch.tensor([3.0 * task.body_length, 0.5 * (config.height - 1)])
    rows, upstream = torch.ones(2, dtype=torch.bool), torch.full((2,), pi)
    solver.reset_(rows, middle.expand(2, 2), upstream, velocity=(1.0, 0.0))
    solver.advance_(14 * period)
    before = solver.body.impulse.clone()
    solver.advance_(4 * period)
    force = (solver.body.impulse - before)[:, 1] / (4 * period)
    slow, fast = (force / (unit**2 * task.body_length)).tolist()  # rho (L/T)^2 L
    assert not solver.is_diverged().any()
    assert abs(slow) < 0.003 < 0.15 < fast  # measured: 0.0007 and 0.20
