"""Policies, critics, hand-crafted controllers and the lateral-line classifier."""

from fishrl.modules.actors import (
    make_actor,
    make_continuous_actor,
    make_mlp,
    make_state_critic,
    make_twin_critics,
)
from fishrl.modules.controllers import InterceptPolicy, PursuitPolicy, RandomPolicy
from fishrl.modules.follower_controllers import KeepPlace
from fishrl.modules.gait_controllers import PID, FixedFrequency, GaitPolicy, KeepCourse, bang_bang
from fishrl.modules.lateral_line import LateralLineClassifier
from fishrl.modules.value_actors import (
    EpsilonGreedy,
    RecurrentPolicy,
    make_recurrent_value_actor,
    make_value_actor,
)

__all__ = [
    "PID",
    "EpsilonGreedy",
    "FixedFrequency",
    "GaitPolicy",
    "InterceptPolicy",
    "KeepCourse",
    "KeepPlace",
    "LateralLineClassifier",
    "PursuitPolicy",
    "RandomPolicy",
    "RecurrentPolicy",
    "bang_bang",
    "make_actor",
    "make_continuous_actor",
    "make_mlp",
    "make_recurrent_value_actor",
    "make_state_critic",
    "make_twin_critics",
    "make_value_actor",
]
