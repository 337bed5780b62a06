"""What the actions of a task command: turns or bends of the body, and its tail beat."""

from fishrl.envs.control.beats import ContinuousFrequency, DirectFrequencies, MacroActions, Steady
from fishrl.envs.control.control import Choice, Control
from fishrl.envs.control.task import AbstractControlTask
from fishrl.envs.control.turns import Bend, Turn

__all__ = [
    "AbstractControlTask",
    "Bend",
    "Choice",
    "ContinuousFrequency",
    "Control",
    "DirectFrequencies",
    "MacroActions",
    "Steady",
    "Turn",
]
