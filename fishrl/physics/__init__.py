"""The flow and the bodies in it: batched immersed-boundary lattice Boltzmann in torch."""

from fishrl.physics.bodies.coupling import Coupling
from fishrl.physics.bodies.fish import Fish
from fishrl.physics.bodies.motion import Bending, Commanded, Driven, Fixed, Free, Oscillating
from fishrl.physics.bodies.outline import Cylinder, DCylinder, Ellipse, Foil
from fishrl.physics.diagnostics import (
    compute_area,
    compute_coefficient,
    compute_pressure,
    compute_spectral_frequency,
    compute_strouhal,
    compute_vorticity,
    find_crossings,
    measure_cycles,
)
from fishrl.physics.fast.solver import InPlaceSolver
from fishrl.physics.flow import FlowConfig, FlowState
from fishrl.physics.storage import Storage
from fishrl.physics.units import Scales

__all__ = [
    "Bending",
    "Commanded",
    "Coupling",
    "Cylinder",
    "DCylinder",
    "Driven",
    "Ellipse",
    "Fish",
    "Fixed",
    "FlowConfig",
    "FlowState",
    "Foil",
    "Free",
    "InPlaceSolver",
    "Oscillating",
    "Scales",
    "Storage",
    "compute_area",
    "compute_coefficient",
    "compute_pressure",
    "compute_spectral_frequency",
    "compute_strouhal",
    "compute_vorticity",
    "find_crossings",
    "measure_cycles",
]
