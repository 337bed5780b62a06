"""The flow and the bodies in it: batched lattice Boltzmann in torch."""

from fishrl.physics.bodies.fish import Fish
from fishrl.physics.bodies.gait import CARANGIFORM, CARLING, LONG_WAVE, Gait
from fishrl.physics.bodies.motion import (
    Bending,
    Commanded,
    Driven,
    Fixed,
    Free,
    Motion,
    Oscillating,
    Surging,
    Towed,
)
from fishrl.physics.bodies.outline import BodyConfig, Cylinder, DCylinder, Ellipse, Foil
from fishrl.physics.bodies.sections import Section
from fishrl.physics.bodies.state import BodyState
from fishrl.physics.bodies.strokes import C_START, Stroke, Strokes
from fishrl.physics.boundaries import (
    Boundaries,
    Boundary,
    NonEquilibrium,
    NoSlip,
    OpenEdge,
    Periodic,
    Profile,
    Side,
)
from fishrl.physics.collision import Rates
from fishrl.physics.diagnostics import (
    compute_coefficient,
    compute_pressure,
    compute_spectral_frequency,
    compute_strouhal,
    compute_vorticity,
    measure_cycles,
)
from fishrl.physics.fast.solver import InPlaceSolver
from fishrl.physics.flow import FlowConfig, FlowParams, FlowState, Sponge
from fishrl.physics.levels.patch import Patch
from fishrl.physics.rollout import simulate
from fishrl.physics.skins import BounceBack, ImmersedBoundary, Skin
from fishrl.physics.units import Scales, compute_tau

__all__ = [
    "CARANGIFORM",
    "CARLING",
    "C_START",
    "LONG_WAVE",
    "Bending",
    "BodyConfig",
    "BodyState",
    "BounceBack",
    "Boundaries",
    "Boundary",
    "Commanded",
    "Cylinder",
    "DCylinder",
    "Driven",
    "Ellipse",
    "Fish",
    "Fixed",
    "FlowConfig",
    "FlowParams",
    "FlowState",
    "Foil",
    "Free",
    "Gait",
    "ImmersedBoundary",
    "InPlaceSolver",
    "Motion",
    "NoSlip",
    "NonEquilibrium",
    "OpenEdge",
    "Oscillating",
    "Patch",
    "Periodic",
    "Profile",
    "Rates",
    "Scales",
    "Section",
    "Side",
    "Skin",
    "Sponge",
    "Stroke",
    "Strokes",
    "Surging",
    "Towed",
    "compute_coefficient",
    "compute_pressure",
    "compute_spectral_frequency",
    "compute_strouhal",
    "compute_tau",
    "compute_vorticity",
    "measure_cycles",
    "simulate",
]
