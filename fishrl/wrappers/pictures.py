"""Pictures of flows for ``render``."""

from typing import Any, cast

import numpy as np
from tensordict import TensorDictBase
from torchrl.envs import TransformedEnv

from fishrl.envs.scene import Ending, Frame
from fishrl.viewer import ViewerSettings, make_env_scene
from fishrl.viewer.film import FramePainter
from fishrl.viewer.recording import list_endings, list_reasons, read_values

Array = np.ndarray[Any, Any]


class Pictures:
    """Paint the current state of each flow, with the path of the nose since its episode began.

    Arguments are those of ``FlowVectorEnv``.
    """

    def __init__(self, env: TransformedEnv, *, render_mode: str | None, field: str) -> None:
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"render_mode = {render_mode!r}: must be 'rgb_array' or None")
        num = int(env.batch_size[0])
        self.flows = env.base_env
        self.scene = make_env_scene(env, ViewerSettings(field=cast("Any", field)))
        self.painters = [
            FramePainter(self.scene, dpi=100.0) for _ in range(num if render_mode else 0)
        ]
        self.is_new = np.ones(num, dtype=np.bool_)  # no picture of the episode yet
        self.endings: list[Ending | None] = [None] * num

    def begin(self, rows: Array) -> None:
        """Begin new episodes in ``rows`` ``[B]`` bool."""
        self.is_new |= rows
        self.endings = [
            None if new else ending for new, ending in zip(rows, self.endings, strict=True)
        ]

    def tell_endings(self, after: TensorDictBase) -> list[Ending | None]:
        """Return how episodes ended in the state ``after`` ``[B]``; the next pictures show it."""
        task = self.flows.task
        self.endings = list_endings(after, task, list_reasons(task, self.flows.now))
        return self.endings

    def paint(self) -> tuple[Array, ...]:
        """Return a picture ``[height, width, 3]``, uint8, of each flow.

        Raises:
            ValueError: without ``render_mode="rgb_array"``.
        """
        if not self.painters:
            raise ValueError("render: make the environment with render_mode='rgb_array'")
        solver, period = self.flows.solver, self.flows.task.scales.period
        values = read_values(self.flows, self.scene)
        frames = [
            Frame(
                time=float(solver.body.age[row]) / period,
                values={name: value[row].cpu() for name, value in values.items()},
                begins=bool(self.is_new[row]),
                ending=self.endings[row],
            )
            for row in range(len(self.painters))
        ]
        self.is_new[:] = False
        return tuple(p.paint(frame) for p, frame in zip(self.painters, frames, strict=True))
