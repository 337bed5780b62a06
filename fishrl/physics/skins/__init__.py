"""How a body's skin and the water act on each other: one class per method."""

from fishrl.physics.skins.bounce_back import BounceBack
from fishrl.physics.skins.force_solve import DirectSolve, ForceSolve, IterativeForcing
from fishrl.physics.skins.immersed_boundary import ImmersedBoundary
from fishrl.physics.skins.skin import Skin

__all__ = [
    "BounceBack",
    "DirectSolve",
    "ForceSolve",
    "ImmersedBoundary",
    "IterativeForcing",
    "Skin",
]
