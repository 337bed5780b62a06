"""Fish without a flow: they move along their headings, so tests of envs take milliseconds."""

from typing import Any

import torch
from torch import Tensor

from fishrl.physics import InPlaceSolver
from fishrl.physics.bodies.fish import Fish
from fishrl.physics.bodies.motion import Driven
from fishrl.physics.bodies.outline import BodyConfig, BodyParams
from fishrl.physics.bodies.state import BodyState

SPEED_BL = 0.4  # body lengths per tail beat


class KinematicSolver(InPlaceSolver):
    """Flows at rest, with straight fish that move and turn at constant rates."""

    def __init__(self, *, compile: bool = True, **options: Any) -> None:
        super().__init__(compile=False, **options)

    def advance_(self, num_steps: int, rows: Tensor | None = None) -> None:
        assert num_steps >= 0 and num_steps % 2 == 0
        super().advance_(0, rows)
        moves = self._choose(rows).double()
        self._batch.flow.clock.add_(num_steps * moves)
        for config, body in zip(self.config.bodies, self.bodies, strict=True):
            if not isinstance(config, Fish) or isinstance(config.motion, Driven):
                continue
            speed = SPEED_BL * config.body_length * body.frequency
            for _ in range(num_steps // 2):
                direction = torch.stack((torch.cos(body.heading), torch.sin(body.heading)), -1)
                body.position.add_(2.0 * (moves * speed)[:, None] * direction)
                body.heading.add_(2.0 * moves * body.turn / body.turn_steps)
                body.age.add_(2.0 * moves)
                body.beats.add_(2.0 * moves * body.frequency)

    def _get_body(self, index: int) -> tuple[BodyConfig, BodyParams, BodyState]:
        """Return a straight body."""
        config, params, body = super()._get_body(index)
        still = torch.zeros_like(body.phase)
        return config, params, body._replace(phase=still, frequency=still, beats=still)
