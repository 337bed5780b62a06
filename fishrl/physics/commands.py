"""Bounds on commands to bodies, whatever writes them: a call, a state or a file."""

from collections.abc import Sequence
from math import pi

import torch
from torch import Tensor

from fishrl.physics.bodies.outline import BodyConfig, BodyParams
from fishrl.physics.bodies.state import BodyState, make_body
from fishrl.physics.fast.checks import check_tensor
from fishrl.physics.flow import FlowConfig, make_params
from fishrl.physics.geometry import deform_body
from fishrl.physics.lattice import MAX_IMPOSED_SPEED

_PHASES = 16
_MOST = 1.0 + 1e-9  # round-off


class Commands:
    """Refuses, on a CPU, commands to the bodies of flows that their constructors would refuse.

    These are a frequency, turn or bend that moves a surface too fast, a towed fish that is too
    fast, and amplitudes beyond the gait's. On a GPU the host would have to wait.

    Args:
        configs: one per flow.
    """

    def __init__(self, configs: Sequence[FlowConfig]) -> None:
        self._configs = configs
        self._growth: dict[int, tuple[list[float], list[float]] | None] = {}
        self._accepted: dict[int, list[list[float]]] = {}

    def forget(self, *indices: int) -> None:
        """Expect these bodies to have other parameters from now on than the configurations'."""
        for index in indices:
            self._growth[index] = None
            self._accepted.pop(index, None)

    @torch.no_grad()
    def check(self, bodies: Sequence[BodyState], params: Sequence[BodyParams]) -> None:
        """Raise ValueError for a command that is not allowed; what was accepted last is free.

        ``bodies`` are the first ones of each flow, ``params`` those of all.
        """
        if not bodies or bodies[0].turn.device.type != "cpu":
            return
        kinds = self._configs[0].bodies
        for index, state in enumerate(bodies):
            if kinds[index].is_still:
                continue
            held = state.velocity[:, 0] if kinds[index].motion.holds_x else state.turn
            order = (state.frequency, state.turn, state.turn_steps, state.amplitude_goal, held)
            # one operator before each advance: numbers are compared on the host
            *now, amplitudes = torch.stack((*order, state.amplitude)).tolist()
            if now != self._accepted.get(index) or any(abs(a) > _MOST for a in amplitudes):
                self._check_body(index, state, params[index])
                self._accepted[index] = now

    def _check_body(self, index: int, state: BodyState, params: BodyParams) -> None:
        kinds = [config.bodies[index] for config in self._configs]
        every, motion = torch.ones_like(state.turn, dtype=torch.bool), kinds[0].motion
        held = state.velocity[:, : int(motion.holds_x)]
        named, reason = f"of body {index}", f": no surface may exceed {MAX_IMPOSED_SPEED} per step"
        grown, faster = self._measure(index, params)
        sizes = [kind.size * by for kind, by in zip(kinds, grown, strict=True)]
        size = torch.tensor(sizes, dtype=state.turn.dtype)
        check_tensor(f"frequency {named}", state.frequency, where=every)
        each = zip(kinds, state.frequency.tolist(), grown, faster, strict=True)
        speed = torch.tensor([_compute_speed(*of) for of in each], dtype=state.turn.dtype)
        if (speed > MAX_IMPOSED_SPEED * _MOST).any():
            most = state.frequency.abs() * MAX_IMPOSED_SPEED / speed
            check_tensor(
                f"frequency {named}", state.frequency, where=every, largest=most, reason=reason
            )
        turning, gait = motion.compute_command_speed(state) * size, ": another gait swings further"
        for what, value, largest, why in (
            ("turn of body {}, speed of the tail", turning, MAX_IMPOSED_SPEED, ""),
            ("velocity of body {}", held, MAX_IMPOSED_SPEED, ""),
            ("amplitude of body {}", state.amplitude_goal, 1.0, gait),
            ("present amplitude of body {}", state.amplitude, 1.0, gait),
        ):
            check_tensor(what.format(index), value, where=every, largest=largest, reason=why)

    def _measure(self, index: int, params: BodyParams) -> tuple[list[float], list[float]]:
        """Return by what the bodies are larger and beat faster than those of the configurations."""
        ones = [1.0] * len(self._configs)
        found = self._growth.get(index, (ones, ones))
        if found is None:
            kind, usual = self._configs[0].bodies[index], make_params(self._configs).bodies[index]
            pairs = zip(_measure_body(kind, params), _measure_body(kind, usual), strict=True)
            grown, faster = ((new / old).expand(len(ones)).tolist() for new, old in pairs)
            found = self._growth[index] = grown, faster
        return found


def _compute_speed(kind: BodyConfig, frequency: float, grown: float, faster: float) -> float:
    """Return the largest speed of a surface larger and beating faster than that of a kind."""
    motion, radius = kind.motion, 0.5 * kind.size
    beating = kind.compute_wall_speed(frequency) - motion.compute_wall_speed(radius, frequency)
    return motion.compute_wall_speed(radius * grown, frequency) + faster * beating


def _measure_body(kind: BodyConfig, params: BodyParams) -> tuple[Tensor, Tensor]:
    """Return the extent of bodies along their axis and the speed of their beat, ``[B]``."""
    zero = torch.zeros_like(params.area)
    state = make_body(torch.stack((zero, zero), -1), zero, zero + 1.0)._replace(beats=zero + 1e3)
    axial = params.draw(state)[0]
    size, speed = axial.amax(-1) - axial.amin(-1), zero + 1.0
    for number in range(_PHASES * kind.deforms):
        outline = deform_body(kind, params, state._replace(phase=zero + pi * number / _PHASES))
        speed = torch.maximum(speed, outline.lateral_velocity.abs().amax(-1))
    return size, speed
