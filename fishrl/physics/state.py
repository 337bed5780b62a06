"""What a flow is: its static configuration and its state."""

from dataclasses import dataclass, field
from typing import NamedTuple

from torch import Tensor

from fishrl.physics.bodies import Fish
from fishrl.physics.boundaries import Boundaries
from fishrl.physics.collision import Rates
from fishrl.physics.delta import Kernel, Roma3
from fishrl.physics.immersed_boundary import ForceSolve, IterativeForcing
from fishrl.physics.rigid_motion import Body, Coupling, Heading
from fishrl.physics.units import check_tau


@dataclass(frozen=True, kw_only=True)
class FlowConfig:
    """Everything about a batch of flows that never changes while they run.

    Args:
        width: nodes along x.
        height: nodes along y.
        tau: relaxation time of the stresses; nu = (tau - 1/2) / 3.
        fish: the body in each flow, or None for a flow without one.
        rates: relaxation rates of the other moments.
        boundaries: the four edges.
        kernel: delta kernel of the immersed boundary.
        force_solve: how no slip is enforced.
        heading: free, or commanded (the default of tasks).
        coupling: implicit, or the paper's explicit one.
    """

    width: int
    height: int
    tau: float
    fish: Fish | None = None
    rates: Rates = field(default_factory=Rates)
    boundaries: Boundaries = field(default_factory=Boundaries)
    kernel: Kernel = field(default_factory=Roma3)
    force_solve: ForceSolve = field(default_factory=IterativeForcing)
    heading: Heading = Heading.COMMANDED
    coupling: Coupling = Coupling.IMPLICIT

    def __post_init__(self) -> None:
        """Refuse a grid too small for its edges or its fish, and an unstable tau."""
        check_tau(self.tau)
        self.force_solve.check(self.kernel)
        for name, size in (("width", self.width), ("height", self.height)):
            if size < 4:
                raise ValueError(f"{name} = {size}: a flow needs at least 4 nodes along each axis")
        if self.fish is not None and self.fish.body_length > min(self.width, self.height) - 4:
            raise ValueError(
                f"body_length = {self.fish.body_length} does not fit into {self.width} x "
                f"{self.height} nodes: enlarge the domain or lower body_length"
            )

    @property
    def nu(self) -> float:
        """Kinematic viscosity in lattice units."""
        return (self.tau - 0.5) / 3.0


class FlowState(NamedTuple):
    """State of a batch of flows.

    Attributes:
        f: ``[B, Q, Y, X]`` incoming populations, shifted by the weights.
        body: the fish in each flow, or None.
    """

    f: Tensor
    body: Body | None = None
