"""Parts of the fast step: functions of tensors that they change in place."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol, TypeVar, TypeVarTuple

import torch
from torch import Tensor
from torch.utils import _pytree as pytree

from fishrl.physics.fast.compiled import InPlaceFunction, compile_inplace, is_stored
from fishrl.physics.fast.identity import identify
from fishrl.physics.fast.recording import Call, record

Trees = TypeVarTuple("Trees")


Memory = TypeVar("Memory")
_GRAPH_PAIRS = 50  # most pairs of steps in one CUDA graph


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
        collect: Callable[[Memory, int], tuple[*Trees]],
        act: Callable[[*Trees], None],
        settings: Mapping[str, Mapping[str, object]] | None,
        *,
        any_grid: bool = False,
    ) -> None:
        self.name, self._settings, self._any_grid = name, settings, any_grid
        self.collect: Callable[[Any, int], tuple[Any, ...]] = collect
        self._act: Callable[..., None] = act
        self._form: pytree.TreeSpec | None = None
        self._num_varying = 0
        self._scratch: list[Tensor] = []  # memory between the kernels, shared by all groups
        self.run: InPlaceFunction = self._act_on

    def bind(self, memory: object) -> tuple[Sequence[Tensor], Sequence[Tensor]]:
        """Return the arguments of ``run`` for a group, at even and at odd steps."""
        even, odd = self.collect(memory, 0), self.collect(memory, 1)
        leaves, self._form = pytree.tree_flatten(even)
        if self._any_grid and leaves[0].device.type == "cpu":
            self._num_varying = len(pytree.tree_leaves(even[0]))
        return leaves, pytree.tree_leaves(odd)

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


class Step(Protocol):
    """What a step consists of: a part, or something that the host decides."""

    @property
    def run(self) -> Callable[..., object]:
        """What it does to its tensors."""

    def record(self, tensors: Sequence[Tensor], /) -> list[Call]:
        """Run once, and return the calls that do the same again."""


Bound = tuple[Part, Sequence[Tensor]]


def compile_parts(parts: Sequence[Bound], *, helps: bool) -> None:
    """Compile parts for arguments like those they come with, in order.

    Processes share the work: what another one compiles is loaded last. One that ``helps`` others
    leaves that, and what cannot be stored for them.
    """
    own = [(part, tensors) for part, tensors in parts if part.key is not None or not helps]
    left = [(part, tensors) for part, tensors in own if not part.compile(tensors, waits=False)]
    for part, tensors in () if helps else left:
        part.compile(tensors)


class Repeater:
    """A pair of an even and an odd step, which repeats: recorded on a CPU, a graph on a GPU."""

    def __init__(self, steps: Sequence[tuple[Step, Sequence[Tensor]]]) -> None:
        self._steps, self._is_cuda = steps, bool(steps) and steps[0][1][0].device.type == "cuda"
        self._calls: list[Call] = []  # recorded in the first pair
        self._graphs: dict[int, torch.cuda.CUDAGraph] = {}  # by number of pairs

    def run(self, num_pairs: int) -> None:
        """Advance by pairs of steps."""
        if not num_pairs:
            return
        if self._is_cuda:
            # what records a graph of more than these steps, records them one by one
            is_recording = torch.cuda.is_current_stream_capturing()
            (self.launch if is_recording else self._run_graphs)(num_pairs)
            return
        if not self._calls:
            calls = [part.record(tensors) for part, tensors in self._steps]
            self._calls = [call for each in calls for call in each]
            num_pairs -= 1
        for _ in range(num_pairs):
            for call in self._calls:
                call()

    def launch(self, num_pairs: int) -> None:
        """Advance by pairs of steps without recording."""
        for _ in range(num_pairs):
            for part, tensors in self._steps:
                part.run(*tensors)

    def _run_graphs(self, num_pairs: int) -> None:
        if not self._graphs:  # kernels are built in a first call, which cannot be captured
            self.launch(1)
            num_pairs -= 1
        while num_pairs > 0:
            self._replay(min(num_pairs, _GRAPH_PAIRS))
            num_pairs -= _GRAPH_PAIRS

    def _replay(self, num_pairs: int) -> None:
        """Advance by pairs of steps that are launched as one CUDA graph, recorded once."""
        with torch.cuda.device(self._steps[0][1][0].device):
            if num_pairs not in self._graphs:
                graph = torch.cuda.CUDAGraph()
                with torch.cuda.graph(graph):
                    self.launch(num_pairs)
                self._graphs[num_pairs] = graph
            self._graphs[num_pairs].replay()


def copy_tree(old: object, new: object) -> None:
    """Copy the tensors of ``new`` into ``old``, a structure of the same form."""
    for a, b in zip(pytree.tree_leaves(old), pytree.tree_leaves(new), strict=True):
        a.copy_(b)
