"""Fish without a flow: they move along their headings, so tests of envs take milliseconds."""

from typing import Any

import torch
from torch import Tensor

from fishrl.physics.bodies.fish import Fish
from fishrl.physics.bodies.motion import Driven
from fishrl.physics.bodies.outline import BodyParams
from fishrl.physics.bodies.state import BodyState, make_body
from fishrl.physics.flow import FlowConfig
from fishrl.physics.geometry import Markers, deform_body, place_markers

SPEED_BL = 0.4  # body lengths per tail beat


class KinematicSolver:
    """Methods of ``InPlaceSolver``, with straight fish that move and turn at constant rates."""

    def __init__(
        self,
        *,
        config: FlowConfig,
        num_envs: int,
        frequency: float = 0.0,
        device: torch.device | str = "cpu",
        **options: Any,
    ) -> None:
        assert config.fish is not None
        self.config, self.num_envs, self.frequency = config, num_envs, frequency
        self.fish, self.shape = config.fish, config.fish.make_params(device)
        rest = torch.zeros(num_envs, dtype=torch.float64, device=device)
        self.stream_speed = rest + config.stream_speed
        fresh = make_body(rest[:, None].expand(-1, 2), rest, rest + frequency)
        num_fish = sum(isinstance(body, Fish) for body in config.bodies)  # no other bodies
        self._fish = [BodyState(*(t.clone() for t in fresh)) for _ in range(num_fish)]
        self.body, self.is_closed = self._fish[0], False

    @property
    def bodies(self) -> list:
        return self._fish

    def compile(self) -> None:
        """There is nothing to compile."""

    def close(self) -> None:
        self.is_closed = True

    def reset_(
        self,
        rows: Tensor,
        position: Tensor,
        heading: Tensor,
        *,
        velocity: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        position = position.view(self.num_envs, -1, 2)
        heading = heading.view(self.num_envs, -1)
        for index, body in enumerate(self._fish):
            own = heading[:, index]
            fresh = make_body(position[:, index], own, torch.full_like(own, self.frequency))
            for old, new in zip(body, fresh, strict=True):
                old.copy_(torch.where(rows.view(-1, *(1,) * (old.dim() - 1)), new, old))

    def command_(
        self,
        turn: Tensor,
        num_steps: int,
        frequency: Tensor | None = None,
        amplitude: Tensor | None = None,
    ) -> None:
        steps = torch.full_like(turn, num_steps)
        given = {"turn": turn, "turn_steps": steps, "frequency": frequency, "amplitude": amplitude}
        for name, value in given.items():
            columns = () if value is None else value.view(self.num_envs, -1).unbind(1)
            for body, column in zip(self._fish, columns, strict=False):
                getattr(body, name).copy_(column)

    def advance_(self, num_steps: int, rows: Tensor | None = None) -> None:
        assert num_steps >= 0 and num_steps % 2 == 0
        moves = torch.ones(self.num_envs) if rows is None else rows.double()
        for own, body in zip(self.config.bodies, self._fish, strict=False):
            if isinstance(own.motion, Driven):  # at rest: held in its place
                continue
            speed = SPEED_BL * self.fish.body_length * body.frequency
            for _ in range(num_steps // 2):
                direction = torch.stack((torch.cos(body.heading), torch.sin(body.heading)), -1)
                body.position.add_(2.0 * (moves * speed)[:, None] * direction)
                body.heading.add_(2.0 * moves * body.turn / body.turn_steps)
                body.age.add_(2.0 * moves)
                body.beats.add_(2.0 * moves * body.frequency)

    def set_populations_(self, f: Tensor, rows: Tensor) -> None:
        """There is no flow to set."""
        assert f.shape[0] == int(rows.sum())

    def set_body_(self, index: int, params: BodyParams, rows: Tensor) -> None:
        """There is no obstacle to change."""

    def set_stream_speed_(
        self, speed: Tensor, rows: Tensor, *, num_steps: int | None = None
    ) -> None:
        self.stream_speed.copy_(torch.where(rows, speed, self.stream_speed))

    def sample(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Return the undisturbed stream."""
        still = torch.zeros(points.shape[:2], device=points.device)
        stream = still + self.stream_speed.float()[:, None]
        return still + 1.0, torch.stack((stream, still), -1)

    def macroscopic(self) -> tuple[Tensor, Tensor]:
        """Return water that turns like a wheel, with a vorticity of 0.02 per step."""
        y, x = torch.meshgrid(
            torch.arange(self.config.height), torch.arange(self.config.width), indexing="ij"
        )
        swirl = 0.01 * torch.stack((-y, x)).float()
        return torch.ones(self.num_envs, *y.shape), swirl.expand(self.num_envs, 2, -1, -1)

    def markers(self, index: int = 0) -> Tensor:
        body = self._fish[index]
        still = torch.zeros_like(body.phase)
        straight = body._replace(phase=still, frequency=still, beats=still)
        return place_markers(body, deform_body(self.fish, self.shape, straight)).position

    def surface(self) -> Markers:
        return place_markers(self.body, deform_body(self.fish, self.shape, self.body))

    def is_diverged(self) -> Tensor:
        outlines = torch.cat([self.markers(index) for index in range(len(self._fish))], 1)
        size = outlines.new_tensor((self.config.width, self.config.height))
        return ~((outlines > 0.5) & (outlines < size - 1.5)).all(-1).all(-1)

    def state_dict(self) -> dict[str, Tensor]:
        return {name: own.clone() for name, own in self._name_state().items()}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        for name, own in self._name_state().items():
            own.copy_(state[name])

    def _name_state(self) -> dict[str, Tensor]:
        """Return the states by name; those of further fish have their number."""
        bodies = {
            name + f"_{index}" * (index > 0): value
            for index, body in enumerate(self._fish)
            for name, value in body._asdict().items()
        }
        return {**bodies, "stream_speed": self.stream_speed}
