"""The base of tasks whose actions a ``Control`` defines."""

from dataclasses import replace
from functools import cached_property
from math import degrees

import torch
from tensordict import TensorDictBase
from torch import Tensor

from fishrl.envs.command import Command
from fishrl.envs.control.beats import MacroActions
from fishrl.envs.control.control import Control
from fishrl.envs.extensions import HasHistory
from fishrl.envs.task import AbstractTask
from fishrl.physics.bodies.fish import Fish
from fishrl.physics.lattice import MAX_IMPOSED_SPEED


class AbstractControlTask(AbstractTask, HasHistory):
    """A task whose actions turn or bend the fish and choose its tail beat, as ``control`` defines.

    The measurement holds ``gear`` and ``frequency`` (beats per T, 0 before the first decision).

    Args:
        control: commands of the actions; its rows are in the order of the flows.
    """

    control: Control = MacroActions()

    def __post_init__(self) -> None:
        if self.control.largest_bend > self.largest_bend:
            raise ValueError(
                f"control bends the fish by {self.control.largest_bend:.3g} L: the tail would move "
                f"at more than {MAX_IMPOSED_SPEED} nodes per step, allowed is "
                f"{self.largest_bend:.3g} L; bend less, raise control.response_T, or lower "
                "max_wall_speed"
            )
        self.check_turn("control", self.control.largest_turn)
        if self.control.num_flows not in (None, 1, self.num_flows):
            raise ValueError(
                f"control has rows for {self.control.num_flows} flows, but the task has "
                f"{self.num_flows}: give one row for each, or one for all"
            )
        super().__post_init__()

    def check_turn(self, name: str, largest: float) -> None:
        """Raise ValueError if a setting turns the fish faster than the method allows, radians."""
        if largest > self.largest_turn:
            raise ValueError(
                f"{name} turns the fish by {degrees(largest):.3g}° within control_interval_T = "
                f"{self.control_interval_T:g}: nose and tail would move at more than "
                f"{MAX_IMPOSED_SPEED} nodes per step, allowed is "
                f"{degrees(self.largest_turn):.3g}°; turn less, raise the interval, or lower "
                "max_wall_speed"
            )

    @property
    def num_flows(self) -> int:
        """Number of flows that ``label_flow`` tells apart."""
        return 1

    @property
    def num_actions(self) -> int:
        """Number of actions, or of the components of one."""
        return self.control.num_actions

    @property
    def action_names(self) -> tuple[str, ...]:
        """Names given by ``control``."""
        return self.control.action_names

    @property
    def action_bounds(self) -> tuple[tuple[float, float], ...] | None:
        """Bounds given by ``control``."""
        return self.control.action_bounds

    @property
    def mirrored_actions(self) -> tuple[int, ...]:
        """Mirror images given by ``control``."""
        return self.control.mirrored_actions

    @property
    def max_frequency(self) -> float:
        """Highest frequency of ``control``."""
        return self.control.max_frequency

    @property
    def swimming_speed(self) -> float:
        """Bound on the speed of a marker, with a bend from one side to the other."""
        share = self.control.largest_bend / self.largest_bend if self.largest_bend else 0.0
        return super().swimming_speed + share * MAX_IMPOSED_SPEED

    @cached_property
    def fish(self) -> Fish:
        """The fish, moved as ``control`` says."""
        return replace(super().fish, motion=self.control.make_motion(self.control_interval_T))

    def label_flow(self, before: TensorDictBase) -> Tensor:
        """Return the label ``[B]`` of the flow, which selects the row of frequencies."""
        return torch.zeros_like(before["gear"])

    def command(self, action: Tensor, before: TensorDictBase) -> Command:
        """Return the choice of ``control``; the next measurement keeps gear and frequency."""
        control = self.control
        choice = control.choose(action, before["gear"], self.label_flow(before))
        for name in ("turn", "bend"):
            if getattr(choice, name) is not None and not getattr(control, f"largest_{name}"):
                raise ValueError(
                    f"{type(control).__name__}.choose gives a {name}: give its largest_{name}"
                )
        return Command(
            turn=choice.turn,
            bend=choice.bend,
            frequency=choice.frequency / self.scales.period,
            amplitude=choice.amplitude,
            kept={"gear": choice.gear, "frequency": choice.frequency},
        )

    def begin(self, now: TensorDictBase) -> dict[str, Tensor]:
        """Start in the first gear of ``control``, at rest."""
        shape = (*now.shape, *((self.num_fish,) if self.num_fish > 1 else ()))
        gear = torch.full(shape, self.control.start_gear, device=now.device)
        return {"gear": gear, "frequency": torch.zeros_like(gear, dtype=torch.float64)}

    def action_mask(self, now: TensorDictBase) -> Tensor:
        """Return the actions that ``control`` allows."""
        gear: Tensor = now["gear"]
        return self.control.mask(gear)
