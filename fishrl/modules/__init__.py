"""Brains of the fish: actors, critics and hand-written swimmers."""

from fishrl.modules.actors import make_actor, make_mlp
from fishrl.modules.controllers import InterceptPolicy, PursuitPolicy, RandomPolicy
from fishrl.modules.critics import make_twin_critics
from fishrl.modules.gait_controllers import PID, BangBang, FixedFrequency, GaitPolicy
from fishrl.modules.lateral_line import LateralLineMachine

__all__ = [
    "PID",
    "BangBang",
    "FixedFrequency",
    "GaitPolicy",
    "InterceptPolicy",
    "LateralLineMachine",
    "PursuitPolicy",
    "RandomPolicy",
    "make_actor",
    "make_mlp",
    "make_twin_critics",
]
