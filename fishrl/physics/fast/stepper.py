"""The fast step: a group of flows in one buffer, in place, compiled.

Order of one step: collide all nodes without force (one pass, 72 bytes a node), then let the bodies
act on the outgoing populations at their marker nodes alone, then set the edges. As collision
conserves mass and momentum, the bodies see the same unforced velocity as in the readable
``step.step``, and the increment they add makes the result equal to the forced collision there. Even
and odd steps are the same code on other views (see ``layout.py``); states are read and written at
even parity only.
"""

import torch
from torch import Tensor

from fishrl.physics.fast.body_parts import make_skin_parts
from fishrl.physics.fast.flow_memory import FlowData
from fishrl.physics.fast.fluid_parts import make_check, make_collision, make_crossing, make_edges
from fishrl.physics.fast.layout import InPlaceLayout
from fishrl.physics.fast.part import Bound, FlowGroup, Part, Repeater, compile_parts
from fishrl.physics.flow import FlowConfig


class Stepper:
    """The parts of a step, shared by all groups.

    ``sample`` holds the numbers of one group's flows, for their shapes and types.

    Attributes:
        parts: in the order in which they run.
        check: which flows are within the method, on request.
        locate: bodies that stay still, or sharp skins, once before many steps.
    """

    def __init__(self, config: FlowConfig, layout: InPlaceLayout, sample: FlowData) -> None:
        device = sample.clock.device
        self.locate: Part | None = None
        self.parts: list[Part] = [make_collision(config)]
        if config.bodies:
            self.locate, parts = make_skin_parts(config.skin, config, layout, sample)
            self.parts += parts
        if config.boundaries.list_crossings(config.height, config.width):
            self.parts.append(make_crossing(config))
        self.parts += [make_edges(config, sides, device) for sides in config.boundaries.in_order()]
        self._is_fine = torch.zeros(layout.num_envs, dtype=torch.bool, device=device)
        self.check = make_check(self._is_fine)

    def list_all(self, *, with_check: bool = True) -> list[Part]:
        """Return all parts: those of a step, the one that locates still bodies, the check."""
        located = [self.locate] if self.locate and self.locate not in self.parts else []
        return [*self.parts, *located, *([self.check] if with_check else ())]

    def compile(self, example: FlowGroup, *, with_check: bool, helps: bool = False) -> None:
        """Compile all parts, for groups of the form of ``example``, as ``compile_parts`` does.

        Only a process that reads the flows needs the check.
        """
        collision, *rest = self.list_all(with_check=with_check)
        # the longest are not the last, so that processes end together
        parts = [(part, example.arguments[part][0]) for part in (*rest, collision)]
        compile_parts(parts, helps=helps)

    def is_new(self, example: FlowGroup) -> bool:
        """Return whether ``compile`` would put new code on the disk."""
        parts = self.list_all()
        return not all(part.is_stored(example.arguments[part][0]) for part in parts)

    def is_fine(self, group: FlowGroup) -> Tensor:
        """Return ``[B]``: whether density and speed are within the method, before an even step."""
        if group.checker is None:
            group.checker = Repeater([(self.check, group.arguments[self.check][0])])
        group.checker.run(1)
        return self._is_fine.clone()

    def advance_(self, group: FlowGroup, num_steps: int) -> None:
        """Advance one group by an even number of steps."""
        num_pairs = num_steps // 2
        if not num_pairs:
            return
        if group.repeaters is None:
            first = [] if self.locate is None else [self.locate]
            located = [(part, group.arguments[part][1]) for part in first]  # as after an odd step
            pair = [*self.list_step(group, 0), *self.list_step(group, 1)]
            group.repeaters = Repeater(located), Repeater(pair)
        locator, repeater = group.repeaters
        locator.run(1)
        repeater.run(num_pairs)

    def list_step(self, group: FlowGroup, parity: int) -> list[Bound]:
        """Return the parts of an even (0) or odd (1) step in order, with a group's arguments."""
        return [(part, group.arguments[part][parity]) for part in self.parts]
