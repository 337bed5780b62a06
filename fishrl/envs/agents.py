"""Layout of the entries of several fish in one environment.

With one fish per flow, its entries are at the top level: ``action`` ``[B]``. With M > 1 fish, they
are in the group ``agents``: ``("agents", "action")`` ``[B, M]``, as in TorchRL's multi-agent
environments; entries of the flow, such as ``done`` ``[B, 1]``, remain at the top level. Policies of
this library act for one fish; ``EachFish`` applies them to each of several.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from fishrl.envs.task import AbstractTask

#: The group of all fish; TorchRL's name for it.
AGENTS = "agents"
#: Before the names of a reward's terms, which are per-fish entries.
TERM = "reward/"


def name_entry(task: AbstractTask, name: str) -> str | tuple[str, str]:
    """Return the key of a per-fish entry."""
    return name if task.num_fish == 1 else (AGENTS, name)


def shape_fish(task: AbstractTask, num_rows: int) -> tuple[int, ...]:
    """Return the shape of one number per fish: ``[B]``, or ``[B, M]`` with several."""
    return (num_rows,) if task.num_fish == 1 else (num_rows, task.num_fish)


def group(entries: Mapping[str, Tensor], shape: tuple[int, ...]) -> dict[str, Any]:
    """Return per-fish entries as an environment stores them; ``shape`` as in ``shape_fish``."""
    if len(shape) == 1:
        return dict(entries)
    return {AGENTS: TensorDict(dict(entries), shape)}


def read_entry(data: TensorDictBase, name: str) -> Tensor | None:
    """Return a per-fish entry, or else the flow's entry; None if neither exists."""
    own: Tensor | None = data.get((AGENTS, name), None)
    return data.get(name, None) if own is None else own


def split_fish(data: TensorDictBase) -> TensorDictBase:
    """Return data ``[B]`` of an environment with M fish as ``[B * M]``, a row for each fish.

    Rows are as in environments with one fish; entries of the flow are repeated. Data of an
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
    """Return a per-fish entry, such as the reward, as ``[B, 1]``; the mean over several fish."""
    own: Tensor = data[AGENTS, name].mean(1) if AGENTS in data else data[name]
    return own


class EachFish(TensorDictModuleBase):
    """Apply a policy to each fish of an environment with several, independently.

    Its input has one row per fish, as from a flow with that fish alone, so the fish share its
    weights. Its output goes to the group ``agents``.

    Args:
        policy: reads and writes entries ``[N, ...]``.
        entries: names of the entries that it writes.
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
