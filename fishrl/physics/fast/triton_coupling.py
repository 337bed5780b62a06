"""The bodies' coupling to the flow on a GPU, as two kernels in Triton.

It does what ``step.couple_bodies`` and ``make_coupling`` of ``body_parts.py`` do as tensor
operations, which remain its reference. The numbers of equations are the paper's, as in
``step.py``; in its notation, for one flow with markers l = 1 .. N:

    U*_l = sum_x W_l u*                         interpolation                            (eq. 2)
    A g = U_d - U*                              K iterations g += w r, r -= w A r        (eq. 4)
    (M - m_f) dU = -sum_l 2 rho g_l ds + load   rigid motion of all bodies together      (eqs. 5, 6)
    F = 2 rho sum_l W_l g_l ds                  spreading, and the populations' answer   (eqs. 3, 1)

Eq. 4 is linear, so it is solved for several right-hand sides at once: row 0 is the slip at the
rates of the last step, row j the velocity that a unit of the j-th degree of freedom gives the
markers. Their solutions g_j follow from the same iteration, and with v = (1, dU_1, dU_2, ...) the
force is g = sum_j v_j g_j.

Nothing is added up by atomics. Each node belongs to the first marker that reaches it; that marker
sums what all markers, in their order, spread to the node, and alone reads and writes it. So results
do not depend on how threads are scheduled: equal runs are equal to the bit.

The markers' weights and the matrix A come from ``geometry.locate_bodies``. A does not fit into
registers or shared memory (N = 332 for a fish of 100 nodes behind a half disc: 430 KB); it is built
by the whole GPU and read through the caches.
"""

import torch
import triton
import triton.language as tl
from torch import Tensor

_GATHERED = 128  # markers whose nodes are read at a time
_SPREAD = 16  # markers whose nodes one program of the second kernel writes
_PRODUCTS = 8192  # of an entry of A and a force, in registers at a time


@triton.jit
def _read(data, offsets, node, mask, SCALE: tl.constexpr, q: tl.constexpr):
    """Read population q at nodes; SCALE as in ``Storage``."""
    return tl.load(data + node + tl.load(offsets + q), mask, 0.0).to(tl.float32) * (1.0 / SCALE)


@triton.jit
def _add(data, offsets, node, mask, SCALE: tl.constexpr, q: tl.constexpr, change):
    """Add a change to population q at nodes."""
    new = (_read(data, offsets, node, mask, SCALE, q) + change) * SCALE
    tl.store(data + node + tl.load(offsets + q), new.to(data.dtype.element_ty), mask)


@triton.jit
def _read_fluid(data, offsets, node, mask, SCALE: tl.constexpr):
    """Return rho and u* at nodes, as ``collision.compute_macroscopic``."""
    f0 = _read(data, offsets, node, mask, SCALE, 0)
    f1 = _read(data, offsets, node, mask, SCALE, 1)
    f2 = _read(data, offsets, node, mask, SCALE, 2)
    f3 = _read(data, offsets, node, mask, SCALE, 3)
    f4 = _read(data, offsets, node, mask, SCALE, 4)
    f5 = _read(data, offsets, node, mask, SCALE, 5)
    f6 = _read(data, offsets, node, mask, SCALE, 6)
    f7 = _read(data, offsets, node, mask, SCALE, 7)
    f8 = _read(data, offsets, node, mask, SCALE, 8)
    d57, d68 = f5 - f7, f6 - f8
    rho = 1.0 + (f0 + ((f1 + f3) + (f2 + f4)) + ((f5 + f7) + (f6 + f8)))
    return rho, ((f1 - f3) + (d57 - d68)) / rho, ((f2 - f4) + (d57 + d68)) / rho


@triton.jit
def _weigh(weights, distance, N: tl.constexpr, SUPPORT: tl.constexpr):
    """Return a marker's weights ``[S, N]`` at nodes ``distance`` beyond its first, on one axis."""
    total = tl.zeros_like(distance)
    for i in tl.static_range(SUPPORT):
        total = tl.where(distance == i, tl.load(weights + i * N), total)
    return total


@triton.jit
def _solve_rigid_motion(matrix, right, i, j, NUM: tl.constexpr):
    """Solve a small system by Gauss-Jordan elimination without pivoting (positive definite)."""
    for n in tl.static_range(NUM):
        row = tl.sum(tl.where(i == n, matrix, 0.0), 0)[None, :]
        value = tl.sum(tl.where(i == n, right, 0.0))
        column = tl.sum(tl.where(j == n, matrix, 0.0), 1)[:, None]
        pivot = tl.sum(tl.where((i == n) & (j == n), matrix, 0.0))
        matrix = tl.where(i == n, row / pivot, matrix - column * (row / pivot))
        right = tl.where(i == n, value / pivot, right - column * (value / pivot))
    return right


@triton.jit
def _solve(
    data, offsets, first_cell, x, y, weight_x, weight_y, spacing, coupling, surface, inertia, push,
    g, slip, mass, change, steps, relaxation,
    N: tl.constexpr, NP: tl.constexpr, SUPPORT: tl.constexpr, SP: tl.constexpr,
    ROWS: tl.constexpr, RP: tl.constexpr, ROW_LENGTH: tl.constexpr, NUM_ITERATIONS: tl.constexpr,
    SCALE: tl.constexpr, BLOCK: tl.constexpr, COLUMNS: tl.constexpr,
):  # fmt: skip
    """Find the force at the markers of one flow, and the motion of its bodies.

    NP, SP and RP are N, SUPPORT and ROWS rounded up to powers of two, as Triton's blocks must be.
    """
    flow = tl.program_id(0)
    first_cell = tl.load(first_cell + flow)
    x, y, spacing, mass = x + flow * N, y + flow * N, spacing + flow * N, mass + flow * N
    weight_x, weight_y = weight_x + flow * SUPPORT * N, weight_y + flow * SUPPORT * N
    coupling, surface = coupling + flow * N * N, surface + flow * ROWS * 2 * N
    g, slip, steps = g + flow * 2 * N, slip + flow * 2 * N, steps + flow * ROWS * 2 * N
    rates = flow * ROWS
    # the nodes around a marker: rows along the first axis, columns along the second
    s = tl.arange(0, SP)
    row, column = s[:, None, None], s[None, :, None]
    is_near = (row < SUPPORT) & (column < SUPPORT)

    # interpolation (eq. 2); g holds U* until the force is known
    for start in range(0, N, BLOCK):
        own = start + tl.arange(0, BLOCK)
        marker = own[None, None, :]
        mask = is_near & (marker < N)
        node_y = tl.load(y + own, own < N, 0.0).to(tl.int64)[None, None, :] + row
        node_x = tl.load(x + own, own < N, 0.0).to(tl.int64)[None, None, :] + column
        node = first_cell + node_y * ROW_LENGTH + node_x
        rho, ux, uy = _read_fluid(data, offsets, node, mask, SCALE)
        weights = tl.load(weight_y + row * N + marker, mask, 0.0)
        weights *= tl.load(weight_x + column * N + marker, mask, 0.0)
        tl.store(g + own, tl.sum(tl.sum(weights * ux, 0), 0), own < N)
        tl.store(g + N + own, tl.sum(tl.sum(weights * uy, 0), 0), own < N)
        rho = tl.sum(tl.sum(weights * rho, 0), 0)
        tl.store(mass + own, 2.0 * rho * tl.load(spacing + own, own < N, 0.0), own < N)
    tl.debug_barrier()

    # no slip (eq. 4) for all right-hand sides
    k, r = tl.arange(0, NP), tl.arange(0, RP)
    has = (r[:, None] < ROWS) & (k[None, :] < N)
    at = r[:, None] * (2 * N) + k[None, :]
    unit_x, unit_y = tl.load(surface + at, has, 0.0), tl.load(surface + N + at, has, 0.0)
    is_slip = r[:, None] == 0
    rest_x = unit_x - tl.where(is_slip, tl.load(g + k, k < N, 0.0)[None, :], 0.0)
    rest_y = unit_y - tl.where(is_slip, tl.load(g + N + k, k < N, 0.0)[None, :], 0.0)
    g_x, g_y = tl.zeros_like(rest_x), tl.zeros_like(rest_y)
    for _ in range(NUM_ITERATIONS):
        g_x += relaxation * rest_x
        g_y += relaxation * rest_y
        tl.store(steps + at, relaxation * rest_x, has)
        tl.store(steps + N + at, relaxation * rest_y, has)
        tl.debug_barrier()
        sum_x = tl.zeros((RP, COLUMNS, NP), tl.float32)
        sum_y = tl.zeros((RP, COLUMNS, NP), tl.float32)
        for start in range(0, N, COLUMNS):
            l = (start + tl.arange(0, COLUMNS))[None, :, None]
            a = tl.load(coupling + l * N + k[None, None, :], (l < N) & (k < N)[None, None, :], 0.0)
            step, given = (
                steps + r[:, None, None] * (2 * N) + l,
                (r < ROWS)[:, None, None] & (l < N),
            )
            sum_x += tl.load(step, given, 0.0) * a
            sum_y += tl.load(step + N, given, 0.0) * a
        rest_x -= tl.sum(sum_x, 1)
        rest_y -= tl.sum(sum_y, 1)
        tl.debug_barrier()

    # rigid motion (eqs. 5, 6): (inertia + added mass) v = push, with v_0 = 1 for the slip itself
    i, j = r[:, None], r[None, :]
    m = tl.load(mass + k, k < N, 0.0)[None, :]
    system = tl.zeros((RP, RP), tl.float64)
    for n in tl.static_range(ROWS):
        response_x = tl.sum(tl.where(i == n, g_x, 0.0), 0)[None, :]
        response_y = tl.sum(tl.where(i == n, g_y, 0.0), 0)[None, :]
        work = tl.sum(m * (unit_x * response_x + unit_y * response_y), 1)[:, None]
        system = tl.where((j == n) & (i > 0), work.to(tl.float64), system)
    masses = tl.load(inertia + rates + i, i < ROWS, 1.0)
    system += tl.where(i == j, masses, 0.0)
    right = tl.load(push + rates + i, i < ROWS, 0.0)
    v = _solve_rigid_motion(system, right, i, j, ROWS)
    tl.store(change + rates + i, v, i < ROWS)
    v = v.to(tl.float32)
    tl.store(g + k, tl.sum(v * g_x, 0), k < N)
    tl.store(g + N + k, tl.sum(v * g_y, 0), k < N)
    tl.store(slip + k, tl.sum(v * rest_x, 0), k < N)
    tl.store(slip + N + k, tl.sum(v * rest_y, 0), k < N)


@triton.jit
def _spread(
    data, offsets, first_cell, omega, x, y, weight_x, weight_y, spacing, g, energy,
    N: tl.constexpr, SUPPORT: tl.constexpr, SP: tl.constexpr, ROW_LENGTH: tl.constexpr,
    HAS_OMEGA_FIELD: tl.constexpr, SCALE: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Spread the force of all markers of one flow to those nodes that ``BLOCK`` markers own."""
    flow = tl.program_id(0)
    x, y, spacing, g = x + flow * N, y + flow * N, spacing + flow * N, g + flow * 2 * N
    weight_x, weight_y = weight_x + flow * SUPPORT * N, weight_y + flow * SUPPORT * N
    k, s = tl.program_id(1) * BLOCK + tl.arange(0, BLOCK), tl.arange(0, SP)[:, None]
    first_y, first_x = tl.load(y + tl.minimum(k, N - 1)), tl.load(x + tl.minimum(k, N - 1))
    bottom, top = tl.min(first_y) - SUPPORT, tl.max(first_y) + SUPPORT
    left, right = tl.min(first_x) - SUPPORT, tl.max(first_x) + SUPPORT
    node_y, node_x = first_y[None, :] + s, first_x[None, :] + s

    # eq. 3, marker by marker, those in reach alone
    force_x = tl.zeros((SP, SP, BLOCK), tl.float32)
    force_y = tl.zeros((SP, SP, BLOCK), tl.float32)
    is_taken = tl.zeros((SP, SP, BLOCK), tl.int1)
    for l in range(N):
        y_l, x_l = tl.load(y + l), tl.load(x + l)
        if (y_l > bottom) & (y_l < top) & (x_l > left) & (x_l < right):
            share_y = _weigh(weight_y + l, node_y - y_l, N, SUPPORT)
            share_x = _weigh(weight_x + l, node_x - x_l, N, SUPPORT)
            share = share_y[:, None, :] * share_x[None, :, :]
            length = tl.load(spacing + l)
            force_x += share * (length * tl.load(g + l))
            force_y += share * (length * tl.load(g + N + l))
            is_taken |= (share != 0.0) & (l < k)[None, None, :]

    # a node belongs to the first marker that reaches it; that one adds the force (eq. 1)
    is_own = (k < N)[None, :] & (s < SUPPORT)
    own_y = tl.load(weight_y + s * N + k[None, :], is_own, 0.0)
    own_x = tl.load(weight_x + s * N + k[None, :], is_own, 0.0)
    mask = (own_y[:, None, :] * own_x[None, :, :] != 0.0) & (is_taken == 0)
    node = tl.load(first_cell + flow) + node_y.to(tl.int64)[:, None, :] * ROW_LENGTH
    node += node_x.to(tl.int64)[None, :, :]
    rho, ux, uy = _read_fluid(data, offsets, node, mask, SCALE)
    force_x, force_y = 2.0 * rho * force_x, 2.0 * rho * force_y
    rate = tl.load(omega + node, mask, 1.0) if HAS_OMEGA_FIELD else tl.load(omega + flow)
    _force(data, offsets, node, mask, SCALE, rho, ux, uy, force_x, force_y, energy, rate)


@triton.jit
def _force(
    data, offsets, node, mask, SCALE: tl.constexpr, rho, ux, uy, fx, fy, energy, omega
):  # fmt: skip
    """Add what ``collision.compute_force_increment`` gives for the whole force at nodes.

    Written out for ``share`` = ``force``, the flux rate cancels: with e the work of the force,
    (1/36) e and f/3 or f/12 go to each population in addition to the stresses pxx and pxy.
    """
    gx, gy = fx * (0.5 / rho), fy * (0.5 / rho)
    of_energy, of_stress = 1.0 - 0.25 * energy, 1.0 - 0.25 * omega
    e = ((ux + of_energy * gx) * fx + (uy + of_energy * gy) * fy) * (1 / 6)
    px, py = ux + of_stress * gx, uy + of_stress * gy
    pxx, pxy = 0.5 * (px * fx - py * fy), 0.25 * (px * fy + py * fx)
    x3, y3 = fx * (1 / 3), fy * (1 / 3)
    sum12, difference12 = (fx + fy) * (1 / 12), (fy - fx) * (1 / 12)
    _add(data, offsets, node, mask, SCALE, 0, -8.0 * e)
    _add(data, offsets, node, mask, SCALE, 1, e + x3 + pxx)
    _add(data, offsets, node, mask, SCALE, 2, e + y3 - pxx)
    _add(data, offsets, node, mask, SCALE, 3, e - x3 + pxx)
    _add(data, offsets, node, mask, SCALE, 4, e - y3 - pxx)
    _add(data, offsets, node, mask, SCALE, 5, e + sum12 + pxy)
    _add(data, offsets, node, mask, SCALE, 6, e + difference12 - pxy)
    _add(data, offsets, node, mask, SCALE, 7, e - sum12 + pxy)
    _add(data, offsets, node, mask, SCALE, 8, e - difference12 - pxy)


@torch.library.triton_op(
    "fishrl::couple_bodies_", mutates_args=("data", "g", "slip", "mass", "change", "steps")
)
def couple_bodies_(
    data: Tensor,
    offsets: Tensor,
    first_cell: Tensor,
    omega: Tensor,
    x: Tensor,
    y: Tensor,
    weight_x: Tensor,
    weight_y: Tensor,
    spacing: Tensor,
    coupling: Tensor,
    surface: Tensor,
    inertia: Tensor,
    push: Tensor,
    g: Tensor,
    slip: Tensor,
    mass: Tensor,
    change: Tensor,
    steps: Tensor,
    row_length: int,
    num_iterations: int,
    relaxation: float,
    energy: float,
    scale: float,
) -> None:
    """Let fluid and bodies act on each other and put the force into the populations.

    All tensors are contiguous, in single precision unless said. R is one more than the degrees of
    freedom that the flow determines, S the kernel's support.

    Args:
        data: outgoing populations of all flows, as stored.
        offsets: ``[Q]`` int64, of each population's slots in ``data``.
        first_cell: ``[B]`` int64, cell of each flow's node (0, 0).
        omega: ``[B, 1]``, or ``[B, cells]`` where it differs from node to node.
        x: ``[B, N]`` column of the first node around each marker; ``y`` is its row.
        y: see ``x``.
        weight_x: ``[B, S, N]`` weights along x.
        weight_y: ``[B, S, N]`` weights along y.
        spacing: ``[B, N]`` length of outline that each marker represents.
        coupling: ``[B, N, N]`` transpose of A.
        surface: ``[B, R, 2, N]`` velocity of the markers, and what a unit of each degree of freedom
            adds to it.
        inertia: ``[B, R]`` float64, 1 and the inertia of each degree of freedom.
        push: ``[B, R]`` float64, 1 and the force or torque on each in addition to the fluid's.
        g: ``[B, 2, N]`` becomes the force per fluid mass.
        slip: ``[B, 2, N]`` becomes the velocity error that is left.
        mass: ``[B, N]`` becomes 2 rho ds.
        change: ``[B, R]`` float64 becomes 1 and the change of each rate.
        steps: ``[B, R, 2, N]`` memory in use during the call.
        row_length: cells from one row of nodes to the next.
        num_iterations: K of the force iteration.
        relaxation: w of the force iteration.
        energy: relaxation rate of the energy.
        scale: factor by which stored populations are larger.
    """
    num_flows, num_rows, _, num_markers = surface.shape
    support = weight_x.shape[1]
    markers, rows = triton.next_power_of_2(num_markers), triton.next_power_of_2(num_rows)
    of_both = {
        "N": num_markers,
        "SUPPORT": support,
        "SP": triton.next_power_of_2(support),
        "ROW_LENGTH": row_length,
        "SCALE": scale,
    }
    torch.library.wrap_triton(_solve)[(num_flows,)](
        data, offsets, first_cell, x, y, weight_x, weight_y, spacing, coupling, surface, inertia,
        push, g, slip, mass, change, steps, relaxation,
        NP=markers, ROWS=num_rows, RP=rows, NUM_ITERATIONS=num_iterations, BLOCK=_GATHERED,
        COLUMNS=max(1, min(16, _PRODUCTS // (rows * markers))), num_warps=8, **of_both,
    )  # fmt: skip
    torch.library.wrap_triton(_spread)[(num_flows, triton.cdiv(num_markers, _SPREAD))](
        data, offsets, first_cell, omega, x, y, weight_x, weight_y, spacing, g, energy,
        HAS_OMEGA_FIELD=omega.shape[1] > 1, BLOCK=_SPREAD, num_warps=2, **of_both,
    )  # fmt: skip
