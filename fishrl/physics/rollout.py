"""Many readable steps as one differentiable function, in the memory of a few.

A step saves about thirty numbers per node for its gradient: a beat at L = 50 in 8 L x 4 L 3.8 GB.
Here steps are grouped into segments. Only the state at the beginning of each is kept, and the steps
of a segment are repeated when the gradient reaches it (Griewank & Walther 2000, with one level), so
that N steps need memory in proportion to sqrt(N), 0.2 GB for that beat. Each step is made twice.
"""

import warnings
from collections.abc import Callable, Sequence
from functools import cache
from math import inf, sqrt
from typing import TypeVar

import torch
from pydantic import PositiveInt
from torch import Tensor
from torch.utils import _pytree as pytree
from torch.utils.checkpoint import checkpoint

from fishrl.physics.commands import Commands
from fishrl.physics.fast.checks import check_tensor
from fishrl.physics.fast.compiled import compile_differentiable
from fishrl.physics.flow import FlowConfig, FlowParams, FlowState, make_params
from fishrl.physics.lattice import Q
from fishrl.physics.placement import check_placement
from fishrl.physics.step import step
from fishrl.physics.units import check_tau
from fishrl.settings import checked

Tree = TypeVar("Tree")


@checked
def simulate(
    state: FlowState,
    config: FlowConfig,
    params: FlowParams | None = None,
    *,
    num_steps: PositiveInt,
    interval: PositiveInt | None = None,
    control: Callable[[int, FlowState], FlowState] | None = None,
    record: Callable[[FlowState], Tree] | None = None,
    segment: PositiveInt | None = None,
    compile: bool = False,
) -> tuple[FlowState, Tree | None]:
    """Advance a batch of flows by many readable steps, differentiably.

    The result depends smoothly on populations, bodies (places, phases, frequencies, bends), and on
    all of ``params`` (viscosity by ``tau``, streams, outlines, gaits); gradients reach whatever of
    these requires them, and whatever ``control`` uses. They equal central differences to 1e-5.
    With a sharp skin that moves, though, the result jumps wherever a node changes sides. Gradients
    are exact between these jumps but leave them out, and miss the trend: optimise with
    ``ImmersedBoundary`` (``studies/gradients`` compares both).

    ``torch.func.jvp``, ``jacfwd`` and ``vmap`` work, and the forward derivatives need no memory;
    ``torch.func.grad``, ``vjp`` and ``jacrev`` need ``segment=num_steps``.

    Args:
        state: populations ``[B, Q, Y, X]``, float32 or float64, and bodies.
        config: configuration of all flows.
        params: as in ``step``.
        num_steps: N, a multiple of ``interval``.
        interval: steps between calls of ``control`` and ``record``; by default those of a step of
            the coarsest level, 2^(levels - 1), of which it is a multiple.
        control: called with the number of the interval and the state at its beginning; returns the
            state to continue with, such as one whose bodies have another ``frequency`` or ``bend``.
            It must not depend on anything that changes between calls with the same number.
        record: called with the state at the end of each interval; returns tensors.
        segment: steps between the states that are kept for the gradient; by default about the
            square root of N. N keeps everything and repeats nothing.
        compile: compile the step and its gradient at the first call for this configuration and
            number of flows, for minutes; then one flow of 64 x 48 nodes is ten times faster. For
            ``backward`` and ``torch.autograd.grad`` alone, without ``create_graph``.

    Returns:
        The state after N steps, and what ``record`` returned, with a new first axis ``[N /
        interval, ...]``; None without it.

    Raises:
        ValueError: for numbers of steps that do not fit together, populations of another type,
            ``compile`` within a transform of ``torch.func``, and, except within such a transform,
            places as ``InPlaceSolver.reset_`` and commands as ``InPlaceSolver.command_``.
    """
    unit = config.coarsest_spacing
    interval = unit if interval is None else interval
    if num_steps % interval or interval % unit:
        raise ValueError(
            f"num_steps = {num_steps}, interval = {interval}: num_steps must be a positive multiple"
            f" of interval, and that of {unit}, the steps of the coarsest level"
        )
    if state.f.dtype not in (torch.float32, torch.float64):
        raise ValueError(f"f is {state.f.dtype}: give float32 or float64, such as state.f.float()")
    commands = Commands([config] * len(state.f))
    if params is None:
        params = make_params([config] * len(state.f), state.f.device)
    else:
        commands.forget(*range(len(config.bodies)))
    is_transformed = torch._C._functorch.peek_interpreter_stack() is not None
    if compile and is_transformed:
        raise ValueError("compile = True: torch.func cannot see into it; give compile = False")
    if not is_transformed:
        width, height = config.coarsest_size
        check_tensor("f", state.f, (None, Q, height, width))
        for tau in params.tau.aminmax():
            check_tau(float(tau))
        every = torch.ones(len(state.f), dtype=torch.bool, device=state.f.device)
        check_placement(config, params.bodies, state.bodies, every)
    advance_once = _compile_step if compile else step
    if compile:
        with torch.no_grad():  # outside of checkpoints, which count all that a call saves
            _compile_step(state, config, params)
    num_intervals = num_steps // interval
    per_segment = max(1, round((segment or sqrt(num_steps * unit)) / interval))

    def advance(state: FlowState, first: int, last: int) -> tuple[FlowState, list[Tree]]:
        noted = []
        for number in range(first, last):
            if control is not None:
                state = control(number, state)
            if not is_transformed:
                commands.check(state.bodies, params.bodies)
            for _ in range(interval // unit):
                state = advance_once(state, config, params)
            if record is not None:
                noted.append(record(state))
        return state, noted

    records: list[Tree] = []
    for first in range(0, num_intervals, per_segment):
        last = min(first + per_segment, num_intervals)
        if torch.is_grad_enabled() and last - first < num_intervals:
            state, noted = checkpoint(advance, state, first, last, use_reentrant=False)
        else:
            state, noted = advance(state, first, last)
        records += noted
    if state.f.requires_grad and config.skin.jumps and not config.is_still:
        warnings.warn(
            "gradients leave out the jumps of a sharp skin, and miss the trend: give skin = "
            "ImmersedBoundary()",
            stacklevel=2,
        )
    if record is None:
        return state, None
    return state, pytree.tree_map(lambda *each: torch.stack(each), *records)


_Leaves = Sequence[Tensor]


@cache
def _hold_steps(config: FlowConfig) -> dict[object, Callable[..., _Leaves]]:
    """Return the compiled steps of a configuration, by the layout of their arguments."""
    return {}


def _compile_step(state: FlowState, config: FlowConfig, params: FlowParams) -> FlowState:
    """Return ``step(state, config, params)``, compiled where it is new."""
    if state.clock is None:
        state = state._replace(clock=torch.full_like(params.ramp_steps, inf))
    leaves, structure = pytree.tree_flatten((state, params))
    leaves = [leaf.contiguous() for leaf in leaves]
    layout = tuple((leaf.shape, leaf.dtype, leaf.device) for leaf in leaves)
    held = _hold_steps(config)
    if layout not in held:

        def advance(*leaves: Tensor) -> _Leaves:
            before, params = pytree.tree_unflatten(leaves, structure)
            return pytree.tree_leaves(step(before, config, params))

        held[layout] = compile_differentiable(advance, leaves)
    after: FlowState = pytree.tree_unflatten(held[layout](*leaves), pytree.tree_structure(state))
    return after
