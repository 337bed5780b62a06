"""The flow and the fish in it: batched immersed-boundary lattice Boltzmann in torch."""

from fishrl.physics.bodies import Fish
from fishrl.physics.diagnostics import compute_area, compute_vorticity
from fishrl.physics.in_place import InPlaceSolver
from fishrl.physics.rigid_motion import Coupling, Heading
from fishrl.physics.state import FlowConfig, FlowState
from fishrl.physics.units import Scales

__all__ = [
    "Coupling",
    "Fish",
    "FlowConfig",
    "FlowState",
    "Heading",
    "InPlaceSolver",
    "Scales",
    "compute_area",
    "compute_vorticity",
]
