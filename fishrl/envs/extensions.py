"""Optional bases of a task: history, flow labels, and what is drawn.

A task inherits those that it needs, next to ``AbstractTask``. Their defaults add nothing, so that a
plain instance of a base stands in for a task without it, see ``find_extension``.
"""

from collections.abc import Mapping
from typing import Any, Self, TypeVar

from tensordict import TensorDictBase
from torch import Tensor

from fishrl.envs.scene import Scene
from fishrl.physics.fast.solver import InPlaceSolver

E = TypeVar("E")


def find_extension(task: object, kind: type[E]) -> E:
    """Return a task as one of the bases below, or a plain instance of it for a task without."""
    return task if isinstance(task, kind) else kind()


class HasHistory:
    """Base of tasks whose measurement holds more than the present flow.

    ``command`` reads all of these entries in ``before``; ``observe`` and ``reward`` read those of
    ``sense``, ``begin`` and ``remember``.
    """

    @property
    def num_samples(self) -> int:
        """W, calls of ``sense`` per action; 0 records no series."""
        return 0

    def sense(self, solver: InPlaceSolver, starts: TensorDictBase) -> dict[str, Tensor]:
        """Return ``[B, ...]`` sensor readings to be recorded as a series within each action.

        Called W times within an action, at equal intervals, the last time at its end. The
        measurement at the next decision holds ``[B, W, ...]``, oldest first. The first sample fills
        the series at reset; the last one is repeated after a row terminates.
        """
        return {}

    def begin(self, now: TensorDictBase) -> dict[str, Tensor]:
        """Return ``[B, ...]`` entries to add to the measurement at the start of an episode."""
        return {}

    def remember(
        self, before: TensorDictBase, action: Tensor, now: TensorDictBase
    ) -> dict[str, Tensor]:
        """Return the entries of ``begin`` after an action.

        ``before`` and ``action`` are those passed to ``command``; ``now`` is the new measurement,
        with the series of ``sense``.
        """
        return {}

    @property
    def inputs(self) -> tuple[str, ...]:
        """Entries ``[B]`` that a transform writes and ``command`` reads."""
        return ()


class HasFlowLabels:
    """Base of tasks whose episodes take place in flows that can be distinguished.

    The task reports ``flow_index`` ``[B]``, the true flow.
    """

    @property
    def flow_labels(self) -> list[dict[str, Any]]:
        """Properties of each flow, ``name`` among them, in the order of ``flow_index``."""
        return []

    @property
    def lateral_line_layout(self) -> Mapping[str, Any]:
        """Layout of the entry ``lateral_line``, which a classifier must match; empty without it."""
        return {}

    @property
    def num_label_inputs(self) -> int:
        """Number of components that a flow-label transform appends to the observation."""
        return 0

    def read_flow_labels(self) -> Self:
        """Return the task whose ``command`` reads the ``flow_class`` that a transform writes."""
        return self


class HasScene:
    """Base of tasks that add to what is drawn of every task, see ``views.make_scene``."""

    @property
    def title(self) -> str:
        """Name of the task; by default that of its class."""
        return ""

    def name_endings(self, now: TensorDictBase) -> dict[str, Tensor]:
        """Return by words, such as "caught", whether they say how an episode ended, ``[B]`` bool.

        The first that is true is shown. ``now`` has the entries of ``measure``.
        """
        return {}

    @property
    def action_names(self) -> tuple[str, ...]:
        """Names of the actions, or of the components of a continuous one; by default numbers."""
        return ()

    def add_to_scene(self, scene: Scene) -> Scene:
        """Return the scene with more in it: ``scene.extend(marks=(Marks(...),))``."""
        return scene

    def read_scene(self, solver: InPlaceSolver, starts: TensorDictBase) -> dict[str, Tensor]:
        """Return ``[B, ...]`` tensors of what was added, by key; arguments as in ``measure``."""
        return {}


def name_flow(task: object, start: TensorDictBase) -> str:
    """Return the name of the flow of one start; empty if flows are not labelled."""
    if not isinstance(task, HasFlowLabels):
        return ""
    return str(task.flow_labels[int(start["flow_index"])]["name"])
