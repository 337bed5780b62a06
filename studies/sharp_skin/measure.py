"""Speeds and frames of the variants: with ``variants.patch`` applied to commit 8ee2319.

``FISHRL_COLL=cg FISHRL_FLUX=1.2 python measure.py swim 32`` prints speed and power in beat 10 at
Re = 7142, ``FISHRL_COLL=cg FISHRL_FILL=lin python measure.py frames 32`` the change of speed with
the frame, and ``FISHRL_COLL=cg python measure.py wave 0`` errors of the viscosity. Compiled code is
kept by source alone: give each variant its own TORCHINDUCTOR_CACHE_DIR.
"""

import math
import sys

import torch

from experiments.validation import invariance
from experiments.validation.swimmer import swim
from fishrl.physics.collision import Rates, collide_mrt, compute_equilibrium, compute_macroscopic
from fishrl.physics.streaming import stream


def measure_viscosity(frame: float, is_diagonal: bool) -> float:
    """Return the relative error of the viscosity of a decaying shear wave, 16 nodes long."""
    n, k, tau = 32, 4.0 * math.pi / 32, 0.51
    y, x = (t.double() for t in torch.meshgrid(torch.arange(n), torch.arange(n), indexing="ij"))
    along = 0.01 * torch.sin(k * (x + y) if is_diagonal else k * x)
    ux = frame + along if is_diagonal else torch.full_like(x, frame)
    f = [t[None] for t in compute_equilibrium(0.0 * x, ux, -along if is_diagonal else along)]
    energies = []
    for _ in range(401):
        uy = compute_macroscopic(f).uy
        energies.append(float(((uy - uy.mean()) ** 2).sum()))
        f = stream(collide_mrt(f, 1.0 / tau, Rates()))
    k2 = k * k * (2 if is_diagonal else 1)
    return math.log(energies[100] / energies[400]) / (2 * k2 * 300) / ((tau - 0.5) / 3.0) - 1.0


if __name__ == "__main__":
    kind, size = sys.argv[1], int(sys.argv[2])
    if kind == "swim":
        run = swim(body_length=size, num_beats=10, reynolds=7142.0, coupling="bounce-back")
        print(run["speed"][-1], run["power"][-1])
    elif kind == "frames":
        invariance.BODY_LENGTH, invariance.SHIFTS, invariance.ANGLES = size, {}, {}
        frames = (-0.08, -0.04, -0.02, -0.01, 0.01, 0.02, 0.04, 0.08)
        invariance.STREAMS = {str(frame): frame for frame in frames}
        runs = invariance.swim_invariantly(is_turned=False, coupling="bounce-back")
        print({name: v[0] / runs[invariance.BASE][0] - 1.0 for name, v in runs.items()})
    else:
        for is_diagonal in (False, True):
            print([measure_viscosity(frame, is_diagonal) for frame in (0.0, 0.05, 0.1, 0.15)])
