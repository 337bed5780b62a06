"""A part of the fast step: a function of tensors that it changes in place."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Generic, TypeVar

from torch import Tensor
from torch.utils import _pytree as pytree

from fishrl.physics.fast.compiled import InPlaceFunction, compile_inplace
from fishrl.physics.fast.flow_memory import GroupMemory

Tensors = TypeVar("Tensors", bound=tuple[Any, ...])


class Part(ABC, Generic[Tensors]):
    """One part of the step, for all groups of flows, at even and odd steps.

    ``Tensors`` is the named tuple of what it reads and writes.

    Attributes:
        title: name in profiles.
        settings: Inductor's settings, by type of device.
        run: the part as a function of the tensors that ``bind`` returns.
    """

    title: ClassVar[str]
    settings: ClassVar[Mapping[str, Mapping[str, object]]] = {}

    def __init__(self) -> None:
        self._form: pytree.TreeSpec | None = None
        self.run: InPlaceFunction = self._act_on

    @abstractmethod
    def collect(self, memory: GroupMemory, parity: int) -> Tensors:
        """Return the tensors of a group at even (0) or odd (1) steps."""

    @abstractmethod
    def act(self, tensors: Tensors) -> None:
        """Run the part, eagerly or traced by the compiler."""

    @property
    def name(self) -> str:
        """Key among the parts of one step."""
        return type(self).__name__

    def bind(self, memory: GroupMemory) -> tuple[Sequence[Tensor], Sequence[Tensor]]:
        """Return the arguments of ``run`` for a group, at even and at odd steps."""
        even, odd = self.collect(memory, 0), self.collect(memory, 1)
        self._form = pytree.tree_structure(even)
        return pytree.tree_leaves(even), pytree.tree_leaves(odd)

    def compile(self, example: Sequence[Tensor], key: str | None) -> None:
        """Compile ``run``; ``key`` determines the flow, None stores nothing on disk."""
        settings = self.settings.get(example[0].device.type, {})
        name = None if key is None else f"{self.name} {key}"
        self.run = compile_inplace(self._act_on, example, name=name, **settings)

    def _act_on(self, *leaves: Tensor) -> None:
        assert self._form is not None
        self.act(pytree.tree_unflatten(leaves, self._form))


def copy_tree(old: object, new: object) -> None:
    """Copy the tensors of ``new`` into ``old``, a structure of the same form."""
    for a, b in zip(pytree.tree_leaves(old), pytree.tree_leaves(new), strict=True):
        a.copy_(b)
