"""A function of tensors that a GPU repeats as one graph: without Python, and without waiting."""

import logging
from collections.abc import Callable, Sequence
from typing import Any, Generic, TypeVar

import torch
from torch import Tensor
from torch.utils import _pytree as pytree

logger = logging.getLogger(__name__)

K = TypeVar("K")


class Repeated(Generic[K]):
    """A function that runs as written at first, and from its second call on as a CUDA graph.

    What it changes besides lies at fixed addresses, and it neither reads the device on the host nor
    copies from the host; if it does, it runs as written, which is logged once. So it does on a CPU.
    Inputs of each form and shape have their own graph.

    Args:
        run: returns a tree of tensors, and something that the host keeps: what it returned in the
            recording. Inputs and results are copied to and from where the graph has them.
        what: it, in words.
    """

    def __init__(self, run: Callable[[Any], tuple[Any, K]], what: str) -> None:
        self._run, self._what = run, what
        self._can_repeat = True
        self._recordings: dict[object, _Recording[K] | None] = {}  # None: to be recorded next time

    def __call__(self, given: Any) -> tuple[Any, K]:
        """Run with a tree of tensors."""
        leaves, form = pytree.tree_flatten(given)
        if not (self._can_repeat and leaves[-1].is_cuda):
            return self._run(given)
        key = form, tuple((leaf.shape, leaf.dtype, leaf.device) for leaf in leaves)
        if key not in self._recordings:  # kernels are built in a first call: it cannot be recorded
            self._recordings[key] = None
            return self._run(given)
        recording = self._recordings[key]
        if recording is None:
            try:
                recording = self._recordings[key] = _Recording(self._run, given)
            except Exception as error:  # noqa: BLE001  # of the task, of torch and of the driver
                self._can_repeat = False
                reason = str(error).strip().partition("\n")[0]
                logger.warning("%s is no CUDA graph and waits for the GPU: %s", self._what, reason)
                return self._run(given)
        return recording.repeat(leaves)


class _Recording(Generic[K]):
    """A function recorded in a graph, with the memory of its inputs and results."""

    def __init__(self, run: Callable[[Any], tuple[Any, K]], given: Any) -> None:
        leaves, form = pytree.tree_flatten(given)
        self._inputs = _join(leaves)
        self._graph = torch.cuda.CUDAGraph()
        placed = pytree.tree_unflatten(_split(self._inputs, leaves), form)
        with torch.cuda.device(leaves[0].device), torch.cuda.graph(self._graph):
            results, self._kept = run(placed)
            self._results, self._form = pytree.tree_flatten(results)
            self._joined = _join(self._results)

    def repeat(self, leaves: Sequence[Tensor]) -> tuple[Any, K]:
        """Run the graph on inputs; return copies of its results."""
        _join(leaves, self._inputs)
        self._graph.replay()
        copies = _split([joined.clone() for joined in self._joined], self._results)
        return pytree.tree_unflatten(copies, self._form), self._kept


def _join(leaves: Sequence[Tensor], out: Sequence[Tensor] | None = None) -> list[Tensor]:
    """Join tensors of each type to one: one launch copies them all."""
    kinds = dict.fromkeys(leaf.dtype for leaf in leaves)
    parts = [[leaf.reshape(-1) for leaf in leaves if leaf.dtype == kind] for kind in kinds]
    if out is None:
        return [torch.cat(own) for own in parts]
    return [torch.cat(own, out=into) for own, into in zip(parts, out, strict=True)]


def _split(joined: Sequence[Tensor], like: Sequence[Tensor]) -> list[Tensor]:
    """Undo ``_join`` of tensors like these."""
    sizes = [[leaf.numel() for leaf in like if leaf.dtype == each.dtype] for each in joined]
    parts = {each.dtype: iter(each.split(own)) for each, own in zip(joined, sizes, strict=True)}
    return [next(parts[leaf.dtype]).view(leaf.shape) for leaf in like]
