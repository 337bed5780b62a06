"""The fast step: a group of flows in one buffer, in place, compiled.

Order of one step: collide all nodes without force (one pass, 72 bytes a node), then let the bodies
act on the outgoing populations at their marker nodes alone, then set the edges. As collision
conserves mass and momentum, the bodies see the same unforced velocity as in the readable
``step.step``, and the increment they add makes the result equal to the forced collision there. Even
and odd steps are the same code on other views (see ``layout.py``); states are read and written at
even parity only.
"""

from typing import Any

import torch
from torch import Tensor

from fishrl.physics.fast.body_parts import (
    BounceOffBodies,
    CoupleBodies,
    LocateSkin,
    LocateStill,
    UncoverNodes,
    keep_geometry,
    keep_skin,
)
from fishrl.physics.fast.compiled import is_own
from fishrl.physics.fast.flow_memory import FlowData
from fishrl.physics.fast.fluid_parts import Check, Collide, CrossPeriodic, SetEdges
from fishrl.physics.fast.gpu_body_parts import (
    CoupleByTriton,
    CouplingBuffers,
    MoveBodies,
    PlaceMarkers,
)
from fishrl.physics.fast.group import FlowGroup
from fishrl.physics.fast.layout import InPlaceLayout
from fishrl.physics.fast.part import Part
from fishrl.physics.flow import Coupling, FlowConfig

_GRAPH_PAIRS = 50  # most pairs of steps in one CUDA graph


class Stepper:
    """The parts of a step, shared by all groups.

    ``sample`` holds the numbers of one group's flows, for their shapes and types. With
    ``uses_triton``, Triton's kernels couple the bodies.

    Attributes:
        parts: in the order in which they run.
        check: which flows are within the method, on request.
        locate: bodies that stay still, or sharp skins, once before many steps.
    """

    def __init__(
        self, config: FlowConfig, layout: InPlaceLayout, sample: FlowData, *, uses_triton: bool
    ) -> None:
        structure, device = config.get_structure(), sample.clock.device
        self._key = repr(structure) if is_own(structure) else None
        self._device = device
        is_sharp = config.coupling is Coupling.BOUNCE_BACK
        is_kept = bool(config.bodies) and not is_sharp and (config.is_still or uses_triton)
        geometry = keep_geometry(config, sample) if is_kept else None
        self.locate: Part[Any] | None = None
        if geometry and config.is_still:
            self.locate = LocateStill(config, geometry)
        self.parts: list[Part[Any]] = [Collide(config)]
        if geometry and uses_triton:
            buffers = CouplingBuffers.make(config, geometry)
            self.parts += [
                PlaceMarkers(config, geometry, buffers),
                CoupleByTriton(config, layout, geometry, buffers),
                MoveBodies(config, geometry, buffers),
            ]
        elif config.bodies and is_sharp:
            skin = keep_skin(config, sample)
            skins = skin, skin if config.is_still else keep_skin(config, sample)
            self.locate = LocateSkin(config, layout, skins)
            self.parts.append(BounceOffBodies(config, layout, skins))
            if not config.is_still:
                self.parts += [self.locate, UncoverNodes(config, layout, skins)]
        elif config.bodies:
            self.parts.append(CoupleBodies(config, layout, geometry, device))
        if config.boundaries.list_crossings(config.height, config.width):
            self.parts.append(CrossPeriodic(config))
        self.parts += [SetEdges(config, sides, device) for sides in config.boundaries.in_order()]
        self.check = Check(config, layout.num_envs, device)

    def list_all(self) -> list[Part[Any]]:
        """Return all parts: those of a step, the check, and the one that locates still bodies."""
        located = [self.locate] if self.locate and self.locate not in self.parts else []
        return [*self.parts, self.check, *located]

    def compile(self, example: FlowGroup) -> None:
        """Compile all but the check, for groups of the form of ``example``."""
        for part in self.list_all():
            if part is not self.check:
                part.compile(example.arguments[part][0], self._key)

    def compile_check(self, example: FlowGroup) -> None:
        """Compile the check, which only the process that reads the flows needs."""
        self.check.compile(example.arguments[self.check][0], self._key)

    def is_fine(self, group: FlowGroup) -> Tensor:
        """Return ``[B]``: whether density and speed are within the method, before an even step."""
        self.check.run(*group.arguments[self.check][0])
        return self.check.is_fine.clone()

    def advance_(self, group: FlowGroup, num_steps: int) -> None:
        """Advance one group by an even number of steps."""
        if self.locate is not None:
            self.locate.run(*group.arguments[self.locate][1])  # as after an odd step
        num_pairs = num_steps // 2
        if self._device.type == "cuda" and num_pairs:
            if not group.graphs:  # kernels are built in a first call, which cannot be captured
                self._advance_pairs_(group, 1)
                num_pairs -= 1
            while num_pairs > 0:
                self._replay_(group, min(num_pairs, _GRAPH_PAIRS))
                num_pairs -= _GRAPH_PAIRS
        else:
            self._advance_pairs_(group, num_pairs)

    def _advance_pairs_(self, group: FlowGroup, num_pairs: int) -> None:
        for _ in range(num_pairs):
            self.step_(group, 0)
            self.step_(group, 1)

    def _replay_(self, group: FlowGroup, num_pairs: int) -> None:
        """Advance by pairs of steps that are launched as one CUDA graph, recorded once."""
        with torch.cuda.device(self._device):
            if num_pairs not in group.graphs:
                graph = torch.cuda.CUDAGraph()
                with torch.cuda.graph(graph):
                    self._advance_pairs_(group, num_pairs)
                group.graphs[num_pairs] = graph
            group.graphs[num_pairs].replay()

    def step_(self, group: FlowGroup, parity: int) -> None:
        """Advance one group by one even (0) or odd (1) step."""
        for part in self.parts:
            part.run(*group.arguments[part][parity])
