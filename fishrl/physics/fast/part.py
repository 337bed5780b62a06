"""Parts of the fast step, functions of tensors that they change in place, and groups of flows."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, TypeVarTuple

import torch
from torch import Tensor
from torch.utils import _pytree as pytree

from fishrl.physics.fast.compiled import InPlaceFunction, compile_inplace, is_stored
from fishrl.physics.fast.flow_memory import GroupMemory
from fishrl.physics.fast.identity import identify
from fishrl.physics.fast.recording import Call, record

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
        self._scratch: list[Tensor] = []  # memory between the kernels, shared by all groups
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
        """What determines ``run`` besides this package's sources; None if that cannot be known."""
        try:
            return f"{self.name} {identify(self._act)} {self._form}"
        except LookupError:
            return None

    def compile(self, example: Sequence[Tensor], *, waits: bool = True) -> bool:
        """Compile ``run``, and keep the code on disk if the part has a key.

        Returns False, without ``waits``, while another process compiles or loads it.
        """
        if self._settings is None:
            return True
        compiled = compile_inplace(
            self._act_on, example, waits=waits, name=self.key, **self._choose_settings(example)
        )
        self.run = compiled or self.run
        return compiled is not None

    def is_stored(self, example: Sequence[Tensor]) -> bool:
        """Return whether ``compile`` would put no new code on the disk."""
        key = self.key
        if self._settings is None or key is None:
            return True
        return is_stored(example, name=key, **self._choose_settings(example))

    def record(self, arguments: Sequence[Tensor]) -> list[Call]:
        """Run once, and return the calls that do the same again."""
        return record(self.run, arguments, self._scratch)

    def _choose_settings(self, example: Sequence[Tensor]) -> dict[str, Any]:
        own = (self._settings or {}).get(example[0].device.type, {})
        return {"num_varying": self._num_varying, **own}

    def _act_on(self, *leaves: Tensor) -> None:
        assert self._form is not None
        self._act(*pytree.tree_unflatten(leaves, self._form))


class FlowGroup:
    """The populations of flows that advance together, and the arguments of the parts of their step.

    Attributes:
        nodes: the nine incoming populations ``[B, Y, X]`` before an even step.
        arguments: arguments of each part, at even and odd steps.
        calls: those of an even and an odd step, recorded on a CPU in the first.
        graphs: CUDA graphs by number of pairs of steps.
    """

    def __init__(self, memory: GroupMemory, parts: Iterable[Part]) -> None:
        self._cells = memory.cells(0)
        self.nodes = memory.incoming(0)
        self.arguments = {part: part.bind(memory) for part in parts}
        self.calls: list[Call] = []
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
