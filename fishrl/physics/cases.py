"""Flows that tests, validation and benchmarks share."""

from fishrl.physics.bodies.fish import Fish
from fishrl.physics.bodies.motion import Commanded, Motion
from fishrl.physics.boundaries import Boundaries, Periodic
from fishrl.physics.flow import FlowConfig
from fishrl.physics.units import Scales

PERIODIC = Boundaries(left=Periodic(), right=Periodic(), bottom=Periodic(), top=Periodic())


def make_swimmer_config(
    scales: Scales,
    *,
    length_bl: float = 10.0,
    height_bl: float = 5.0,
    motion: Motion | None = None,
    **changes: object,
) -> FlowConfig:
    """Return the paper's tank, 10 L x 5 L with walls all round, and a NACA0012 fish in it.

    The fish's heading is commanded unless ``motion`` says otherwise; ``changes`` are any other
    fields of ``FlowConfig``.
    """
    fish = Fish(body_length=scales.body_length, gait=scales.gait, motion=motion or Commanded())
    fields: dict[str, object] = {
        "width": round(length_bl * scales.body_length),
        "height": round(height_bl * scales.body_length),
        "tau": scales.tau,
        "bodies": (fish,),
    }
    return FlowConfig(**(fields | changes))  # type: ignore[arg-type]
