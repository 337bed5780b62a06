"""The interface of a solver to tasks: their sensors and views reach the flow only through it.

``InPlaceSolver`` fulfils it and documents the arguments; so does any stand-in with these methods,
such as one without a flow in tests. All quantities are in lattice units, with a leading batch axis
B.
"""

from collections.abc import Sequence
from typing import Protocol

from torch import Tensor

from fishrl.physics.bodies.outline import BodyParams
from fishrl.physics.bodies.state import BodyState
from fishrl.physics.flow import FlowConfig
from fishrl.physics.geometry import Markers


class Solver(Protocol):
    """B flows and the bodies in them, advanced in place; ``config`` describes the first flow.

    The grid is the same in all, bodies may differ in their parameters. Tensors from ``body`` and
    ``bodies`` change in place: copy what is kept.
    """

    config: FlowConfig
    num_envs: int

    @property
    def bodies(self) -> Sequence[BodyState]:
        """The bodies' states, in the order of ``config.bodies``."""

    @property
    def body(self) -> BodyState:
        """The state of the first body, the fish; ``body.age`` counts the steps since reset."""

    def markers(self, index: int = 0) -> Tensor:
        """Return the closed outline ``[B, N, 2]`` (x, y) of a body in nodes, nose first."""

    def surface(self, index: int = 0) -> Markers:
        """Return the markers of a body: position, arm, velocity without the rigid motion."""

    def macroscopic(self) -> tuple[Tensor, Tensor]:
        """Return density ``[B, Y, X]`` and velocity ``[B, 2, Y, X]`` in nodes per step."""

    def sample(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Return density ``[B, P]`` and velocity ``[B, P, 2]`` at points ``[B, P, 2]`` in nodes."""

    def is_diverged(self) -> Tensor:
        """Return ``[B]`` bool: not finite, too fast for the method, or a body outside the grid."""

    def reset_(
        self,
        rows: Tensor,
        position: Tensor,
        heading: Tensor,
        *,
        velocity: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        """Put the bodies of the flows in ``rows`` ``[B]`` at rest; others are not touched."""

    @property
    def stream_speed(self) -> Tensor:
        """Unit of the velocities that the edges impose at present ``[B]``, nodes per step."""

    def set_stream_speed_(
        self, speed: Tensor, rows: Tensor | None = None, *, num_steps: int | None = None
    ) -> None:
        """Set the stream speed ``[B]`` of the flows of ``rows`` ``[B]``, all by default.

        It changes smoothly over ``num_steps``, or at once.
        """

    def set_body_(self, index: int, params: BodyParams, rows: Tensor) -> None:
        """Give a body of the flows of ``rows`` ``[B]`` other parameters ``[B, ...]``."""

    def set_populations_(self, f: Tensor, rows: Tensor) -> None:
        """Set the N flows of ``rows`` ``[B]`` to shifted populations ``[N, Q, Y, X]``."""

    def command_(
        self,
        turn: Tensor,
        num_steps: int,
        frequency: Tensor | None = None,
        amplitude: Tensor | None = None,
    ) -> None:
        """Command the first body, or with ``[B, M]`` the first M, to turn and beat."""

    def advance_(self, num_steps: int, rows: Tensor | None = None) -> None:
        """Advance the flows of ``rows`` ``[B]`` (all by default) by an even number of steps.

        Other rows are undefined after the call.
        """
