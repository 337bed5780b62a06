"""Time series of named values, recorded in several episodes at once."""

from collections import defaultdict
from collections.abc import Iterator, Mapping
from math import isnan

import torch
from torch import Tensor
from torch.nn.functional import pad
from torch.nn.utils.rnn import pad_sequence


class Traces(Mapping[str, list[Tensor]]):
    """Recordings of E episodes: for each name, E tensors ``[N, ...]`` in order of time.

    Tensors are copies on the CPU; their lengths N differ with the episodes.

    Args:
        num_episodes: E.
    """

    def __init__(self, num_episodes: int) -> None:
        self.num_episodes = num_episodes
        self._parts: dict[str, list[tuple[Tensor, Tensor]]] = defaultdict(list)

    def add(self, episode: Tensor, values: Mapping[str, Tensor]) -> None:
        """Append values ``[B, ...]``, one row to each episode.

        Args:
            episode: ``[B]`` int64, index of the episode that each row belongs to; -1 for none.
            values: by name; different calls may give different names.
        """
        owner = episode.to("cpu", copy=True)
        for name, value in values.items():
            self._parts[name].append((owner, value.detach().to("cpu", copy=True)))

    def __getitem__(self, name: str) -> list[Tensor]:
        """Return the trace ``[N, ...]`` of each episode under a name."""
        if name not in self._parts:
            raise KeyError(name)
        owners, values = (torch.cat(part) for part in zip(*self._parts[name], strict=True))
        order = owners.argsort(stable=True)
        owners, values = owners[order], values[order]
        is_owned = owners >= 0
        counts = torch.bincount(owners[is_owned], minlength=self.num_episodes)
        return list(values[is_owned].split(counts.tolist()))

    def __iter__(self) -> Iterator[str]:
        return iter(self._parts)

    def __len__(self) -> int:
        return len(self._parts)

    def of(self, episode: int) -> dict[str, Tensor]:
        """Return all traces of one episode, ``[N, ...]`` by name."""
        return {name: self[name][episode] for name in self}

    def pad(self, name: str, *, value: float = torch.nan, length: int = 0) -> Tensor:
        """Return the traces under a name as ``[E, N, ...]``, filled with ``value`` at their ends.

        N is the length of the longest episode, or ``length`` if that is greater. With NaN, which
        only floats can hold, other numbers become float64.
        """
        traces = self[name]
        if isnan(value) and not traces[0].is_floating_point():
            traces = [trace.double() for trace in traces]
        padded = pad_sequence(traces, batch_first=True, padding_value=value)
        missing = max(0, length - padded.shape[1])
        return pad(padded, (0, 0) * (padded.dim() - 2) + (0, missing), value=value)
