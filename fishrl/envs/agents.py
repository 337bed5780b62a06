"""Several fish that learn: where an environment keeps what is theirs.

Where each flow has one fish, its entries stand at the top: ``action`` ``[B]``. Where a task has M >
1 fish, they stand in the group ``agents``: ``("agents", "action")`` ``[B, M]``, as in TorchRL's
multi-agent environments, and entries of the flow, such as ``done`` ``[B, 1]``, stay at the top. A
policy of this library decides for one fish; ``EachFish`` lets it decide for each of several.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from fishrl.envs.task import AbstractTask

#: The group of all fish; TorchRL's name for it.
AGENTS = "agents"


def name_entry(task: AbstractTask, name: str) -> str | tuple[str, str]:
    """Return the key of an entry that each fish has."""
    return name if task.num_fish == 1 else (AGENTS, name)


def shape_fish(task: AbstractTask, num_rows: int) -> tuple[int, ...]:
    """Return the shape of a number for each fish: ``[B]``, or of several ``[B, M]``."""
    return (num_rows,) if task.num_fish == 1 else (num_rows, task.num_fish)


def group(entries: Mapping[str, Tensor], shape: tuple[int, ...]) -> dict[str, Any]:
    """Return entries of each fish as an environment keeps them; ``shape`` see ``shape_fish``."""
    if len(shape) == 1:
        return dict(entries)
    return {AGENTS: TensorDict(dict(entries), shape)}


def read_entry(data: TensorDictBase, name: str) -> Tensor | None:
    """Return an entry of each fish, or else of the flow; None if there is no such entry."""
    own: Tensor | None = data.get((AGENTS, name), None)
    return data.get(name, None) if own is None else own


def split_fish(data: TensorDictBase) -> TensorDictBase:
    """Return data ``[B]`` of an environment with M fish as ``[B * M]``, a row for each fish.

    Rows are those of environments with one fish; what belongs to the flow is repeated. Data of an
    environment with one fish are returned as they are.
    """
    if AGENTS not in data:
        return data
    num_fish = data[AGENTS].batch_size[-1]

    def widen(part: TensorDictBase) -> TensorDictBase:
        shared = part.exclude(AGENTS, "next").unsqueeze(-1).expand(*part.shape, num_fish)
        rows = shared.copy().update(part[AGENTS])
        return rows.set("next", widen(part["next"])) if "next" in part else rows

    return widen(data).reshape(-1)


def average_fish(data: TensorDictBase, name: str) -> Tensor:
    """Return an entry ``[B, 1]`` of each fish, such as its reward; of several fish their mean."""
    if AGENTS not in data:
        own: Tensor = data[name]
        return own
    mean: Tensor = data[AGENTS, name].mean(1)
    return mean


class EachFish(TensorDictModuleBase):
    """Let a policy decide for each fish of an environment with several, by itself.

    Its input has a row for each fish, as from a flow with that fish alone, so the fish share its
    weights. What it writes goes to the group ``agents``.

    Args:
        policy: reads and writes entries ``[N, ...]``.
        entries: those it writes.
    """

    def __init__(
        self,
        policy: Callable[[TensorDictBase], TensorDictBase],
        entries: Sequence[str] = ("action",),
    ) -> None:
        super().__init__()
        self.policy, self.entries = policy, tuple(entries)
        self.in_keys, self.out_keys = [AGENTS], [(AGENTS, name) for name in self.entries]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``("agents", name)`` ``[B, M, ...]`` for each entry."""
        rows = self.policy(split_fish(tensordict)).select(*self.entries)
        own = tensordict[AGENTS]
        own.update(rows.reshape(own.batch_size))
        return tensordict
