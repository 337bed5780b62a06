"""The yardstick: the same collision, fused with pulling from a second buffer, by numba.

Nine populations in padded rows, one loop over all nodes, shared out to the threads by rows. The
grid is compiled in, so that all addresses of a row differ by constants and the loop is vectorised.
"""

from collections.abc import Callable

import numpy as np

from fishrl.physics.collision import Rates
from fishrl.physics.lattice import CX, CY

Advance = Callable[..., None]


def make_kernels(width: int, height: int, pitch: int, omega: float) -> tuple[Advance, Advance]:
    """Compile the pulling collision and the halo; ``pitch`` is that of rows with their halo."""
    import numba

    plane = (height + 2) * pitch
    # population q of a node comes from the node at -c_q
    o0, o1, o2, o3, o4, o5, o6, o7, o8 = (q * plane - CY[q] * pitch - CX[q] for q in range(9))
    rates, f32 = Rates(), np.float32
    at = np.uintp  # an index that is never negative needs no branch
    s_e, s_q, s_v = f32(rates.energy), f32(rates.flux), f32(omega)
    one, two, three, four = f32(1), f32(2), f32(3), f32(4)
    r36, r6, r4, half = f32(1 / 36), f32(1 / 6), f32(0.25), f32(0.5)

    @numba.njit(parallel=True, fastmath=True, error_model="numpy", boundscheck=False)
    def pull(source, target):  # type: ignore[no-untyped-def]
        for y in numba.prange(height):
            start = (y + 1) * pitch + 1
            for n in range(start, start + width):
                f0, f1, f2 = source[at(n + o0)], source[at(n + o1)], source[at(n + o2)]
                f3, f4, f5 = source[at(n + o3)], source[at(n + o4)], source[at(n + o5)]
                f6, f7, f8 = source[at(n + o6)], source[at(n + o7)], source[at(n + o8)]
                a13, a24, a57, a68 = f1 + f3, f2 + f4, f5 + f7, f6 + f8
                d13, d24, d57, d68 = f1 - f3, f2 - f4, f5 - f7, f6 - f8
                axis, diagonal = a13 + a24, a57 + a68
                rho = f0 + axis + diagonal
                jx, jy = d13 + (d57 - d68), d24 + (d57 + d68)
                inverse = one / (rho + one)
                jxx, jyy, jxy = jx * jx * inverse, jy * jy * inverse, jx * jy * inverse
                u2 = three * (jxx + jyy)
                e = r36 * s_e * (two * (diagonal + rho) - four * f0 - axis - u2)
                eps = r36 * s_e * (four * f0 - two * axis + diagonal - rho + u2)
                qx = r6 * s_q * ((d57 - d68) - two * d13 + jx)
                qy = r6 * s_q * ((d57 + d68) - two * d24 + jy)
                pxx = r4 * s_v * (a13 - a24 - (jxx - jyy))
                pxy = r4 * s_v * (a57 - a68 - jxy)
                on_axis, off_axis = -e - two * eps, two * e + eps
                plus, minus = half * (qx + qy), half * (qy - qx)
                target[at(n)] = f0 - four * (eps - e)
                target[at(n + plane)] = f1 - (on_axis - qx + pxx)
                target[at(n + 2 * plane)] = f2 - (on_axis - qy - pxx)
                target[at(n + 3 * plane)] = f3 - (on_axis + qx + pxx)
                target[at(n + 4 * plane)] = f4 - (on_axis + qy - pxx)
                target[at(n + 5 * plane)] = f5 - (off_axis + plus + pxy)
                target[at(n + 6 * plane)] = f6 - (off_axis + minus - pxy)
                target[at(n + 7 * plane)] = f7 - (off_axis - plus + pxy)
                target[at(n + 8 * plane)] = f8 - (off_axis - minus - pxy)

    @numba.njit
    def wrap(data):  # type: ignore[no-untyped-def]
        for q in range(9):
            for y in range(1, height + 1):
                row = q * plane + y * pitch
                data[row] = data[row + width]
                data[row + width + 1] = data[row + 1]
            first, last = q * plane, q * plane + (height + 1) * pitch
            for x in range(width + 2):
                data[first + x] = data[last - pitch + x]
                data[last + x] = data[first + pitch + x]

    return pull, wrap
