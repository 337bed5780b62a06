"""Fish without a flow: they move along their headings, and tests of envs take milliseconds."""

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
        compile: bool = True,
        num_workers: int | None = None,
    ) -> None:
        assert config.fish is not None
        self.config, self.num_envs, self.frequency = config, num_envs, frequency
        self.shape = config.fish.make_params(device)
        self.stream_speed = torch.full(
            (num_envs,), config.stream_speed, dtype=torch.float64, device=device
        )
        rest = torch.zeros(num_envs, dtype=torch.float64, device=device)
        fresh = make_body(rest[:, None].expand(-1, 2), rest, rest + frequency)
        self._fish = [
            BodyState(*(t.clone() for t in fresh))
            for body in config.bodies
            if isinstance(body, Fish)  # other bodies are not there
        ]
        self.body = self._fish[0]
        self.is_closed = False

    @property
    def bodies(self) -> list:
        return self._fish

    def compile(self, *, wait: bool = True) -> None:
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
        turn = turn.view(self.num_envs, -1)
        for index, body in enumerate(self._fish[: turn.shape[1]]):
            body.turn.copy_(turn[:, index])
            body.turn_steps.fill_(num_steps)
            if frequency is not None:
                body.frequency.copy_(frequency.view(self.num_envs, -1)[:, index])
            if amplitude is not None:
                body.amplitude.copy_(amplitude.view(self.num_envs, -1)[:, index])

    def advance_(self, num_steps: int, rows: Tensor | None = None) -> None:
        assert num_steps >= 0 and num_steps % 2 == 0
        assert self.config.fish is not None
        moves = torch.ones(self.num_envs) if rows is None else rows.double()
        for own, body in zip(self.config.bodies, self._fish, strict=False):
            if isinstance(own.motion, Driven):  # at rest: held in its place
                continue
            speed = SPEED_BL * self.config.fish.body_length * body.frequency
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
        assert self.config.fish is not None
        return place_markers(body, deform_body(self.config.fish, self.shape, straight)).position

    def surface(self) -> Markers:
        assert self.config.fish is not None
        return place_markers(self.body, deform_body(self.config.fish, self.shape, self.body))

    def is_diverged(self) -> Tensor:
        outlines = torch.cat([self.markers(index) for index in range(len(self._fish))], 1)
        x, y = outlines.unbind(-1)
        width, height = self.config.width, self.config.height
        is_inside = (x > 0.5) & (x < width - 1.5) & (y > 0.5) & (y < height - 1.5)
        return ~is_inside.all(-1)

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
