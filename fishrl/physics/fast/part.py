"""Parts of the fast step, functions of tensors that they change in place, and groups of flows."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from types import FunctionType
from typing import Any, TypeVarTuple

import torch
from torch import Tensor
from torch.utils import _pytree as pytree

from fishrl.physics.bodies.outline import BodyConfig
from fishrl.physics.fast.compiled import (
    InPlaceFunction,
    IsBeingMadeError,
    compile_inplace,
    is_own,
    is_stored,
)
from fishrl.physics.fast.flow_memory import GroupMemory
from fishrl.physics.flow import FlowConfig

Trees = TypeVarTuple("Trees")


class Part:
    """One part of the step, for all groups of flows, at even and odd steps.

    Args:
        name: key among the parts of one step.
        collect: returns the arguments of ``act`` for a group, trees of tensors, at even (0) or odd
            (1) steps.
        act: what the part does, eagerly or traced by the compiler. Flows share the compiled code if
            all that it closes over is equal, so it should close over no more than it needs.
        settings: Inductor's settings, by type of device; None leaves the part eager.
        any_grid: on a CPU, flows on grids of other sizes share the code: all that ``act`` needs of
            the grid is in its first argument.

    Attributes:
        run: ``act`` as a function of the tensors that ``bind`` returns.
    """

    def __init__(
        self,
        name: str,
        collect: Callable[[GroupMemory, int], tuple[*Trees]],
        act: Callable[[*Trees], None],
        settings: Mapping[str, Mapping[str, object]] | None,
        *,
        any_grid: bool = False,
    ) -> None:
        self.name, self._settings, self._any_grid = name, settings, any_grid
        self.collect: Callable[[GroupMemory, int], tuple[Any, ...]] = collect
        self._act: Callable[..., None] = act
        self._form: pytree.TreeSpec | None = None
        self._num_varying = 0
        self.run: InPlaceFunction = self._act_on

    def bind(self, memory: GroupMemory) -> tuple[Sequence[Tensor], Sequence[Tensor]]:
        """Return the arguments of ``run`` for a group, at even and at odd steps."""
        even, odd = self.collect(memory, 0), self.collect(memory, 1)
        self._form = pytree.tree_structure(even)
        if self._any_grid and memory.populations.device.type == "cpu":
            self._num_varying = len(pytree.tree_leaves(even[0]))
        return pytree.tree_leaves(even), pytree.tree_leaves(odd)

    @property
    def key(self) -> str | None:
        """What determines ``run`` besides this package's sources; None if anything else does."""
        known = _find_known(self._act)
        return f"{self.name} {known} {self._form}" if is_own(known) else None

    def compile(self, example: Sequence[Tensor], *, waits: bool = True) -> bool:
        """Compile ``run``, and keep the code on disk if the part has a key.

        Returns False, without ``waits``, while another process compiles or loads it.
        """
        if self._settings is None:
            return True
        settings = self._settings.get(example[0].device.type, {})
        try:
            self.run = compile_inplace(
                self._act_on,
                example,
                name=self.key,
                num_varying=self._num_varying,
                waits=waits,
                **settings,
            )
        except IsBeingMadeError:
            return False
        return True

    def is_to_be_stored(self, example: Sequence[Tensor]) -> bool:
        """Return whether ``compile`` would put new code on the disk."""
        if self._settings is None or self.key is None:
            return False
        settings = self._settings.get(example[0].device.type, {})
        return not is_stored(example, name=self.key, num_varying=self._num_varying, **settings)

    def _act_on(self, *leaves: Tensor) -> None:
        assert self._form is not None
        self._act(*pytree.tree_unflatten(leaves, self._form))


def _find_known(thing: object) -> object:
    """Return ``thing``, of this package's functions all that they close over, in any depth.

    Of a flow or a body it is what those of a batch share: nothing else may shape the code.
    """
    if isinstance(thing, tuple):
        return list(map(_find_known, thing))
    if isinstance(thing, FunctionType) and thing.__module__.startswith("fishrl.physics."):
        held = [cell.cell_contents for cell in thing.__closure__ or ()]
        return [thing.__defaults__, thing.__kwdefaults__, *map(_find_known, held)]
    return thing.get_structure() if isinstance(thing, FlowConfig | BodyConfig) else thing


class FlowGroup:
    """The populations of flows that advance together, and the arguments of the parts of their step.

    Attributes:
        nodes: the nine incoming populations ``[B, Y, X]`` before an even step.
        arguments: arguments of each part, at even and odd steps.
        graphs: CUDA graphs by number of pairs of steps.
    """

    def __init__(self, memory: GroupMemory, parts: Iterable[Part]) -> None:
        self._cells = memory.cells(0)
        self.nodes = memory.incoming(0)
        self.arguments = {part: part.bind(memory) for part in parts}
        self.graphs: dict[int, torch.cuda.CUDAGraph] = {}

    def write_(self, rows: Tensor, f: Tensor) -> None:
        """Set the incoming populations ``[N, Q, Y, X]`` of the flows ``rows`` ``[N]``, indices."""
        for view, values in zip(self.nodes, f.unbind(1), strict=True):
            view[rows] = values

    def fill_(self, rows: Tensor, f: Sequence[Tensor]) -> None:
        """Set all cells of the flows in ``rows`` ``[B]`` bool to the populations ``[B]``."""
        for view, value in zip(self._cells, f, strict=True):
            view.copy_(torch.where(rows[:, None], value[:, None], view))


def copy_tree(old: object, new: object) -> None:
    """Copy the tensors of ``new`` into ``old``, a structure of the same form."""
    for a, b in zip(pytree.tree_leaves(old), pytree.tree_leaves(new), strict=True):
        a.copy_(b)
