"""How many flows an environment advances together, and on which machine parts."""

from typing import Annotated

from pydantic import NonNegativeInt, PositiveInt

from fishrl.settings import Role, Settings


class Flows(Settings):
    """Number of flows, and how they are computed; ``InPlaceSolver`` takes the same arguments.

    Args:
        num_envs: flows that advance together.
        device: cpu or cuda.
        compile: compile the flow step; otherwise it runs eagerly, about 50 times slower.
        num_workers: CPU processes that share the flows; by default one per core.
    """

    num_envs: PositiveInt = 16
    device: Annotated[str, Role.HARMLESS] = "cpu"
    compile: Annotated[bool, Role.HARMLESS] = True
    num_workers: Annotated[NonNegativeInt | None, Role.HARMLESS] = None
