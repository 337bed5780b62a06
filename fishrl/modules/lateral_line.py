"""The lateral-line machine: which flow is the fish in, from what its lateral line felt.

The paper's machine is a fully connected network on one instant of ``[t, x, y, u_x, u_y, p, |u|]``,
averaged over five points. Here the network is the same, and what it reads is a choice: which
features, and how many of the newest samples. Time and place give a flow away by bookkeeping, so
they are left out unless asked for.
"""

from __future__ import annotations

import pickle
from collections.abc import Mapping, Sequence
from math import isclose
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from fishrl.modules.actors import make_mlp

#: Features of the paper that name the place and the clock instead of the flow.
BOOKKEEPING = ("t", "x", "y")
_FORMAT = "fishrl lateral-line machine, 1"
_SENSOR_KEYS = ("num_neuromasts", "features", "num_samples")


class LateralLineClassifier(nn.Module):
    """Classifier of flows; maps ``lateral_line`` ``[..., W, P, F]`` to logits ``[..., n]``.

    W samples (oldest first, equally spaced in time), P neuromasts, F features, n flows.

    Args:
        flows: what tells the n flows apart, one mapping per class in the order of ``flow_index``,
            each with a ``name`` and numbers such as ``stream_speed_bl``.
        sensors: description of the lateral line: ``num_neuromasts``, the names of its
            ``features``, ``num_samples`` per control interval, and whatever else it depends on.
        features: names of those that are read; by default all but time and place.
        num_samples: how many of the newest samples are read; by default one control interval of
            them. More than that need the signals of several intervals, one after the other.
        hidden: widths of the hidden layers.
        generator: source of the initial weights.

    Attributes:
        mean, scale: ``[P, F']`` of what is read, which becomes (value - mean) / scale; see
            ``set_normalisation``.

    Raises:
        ValueError: for fewer than two flows, flows of one name, features that the sensors do not
            have, or fewer than one sample.
    """

    mean: Tensor
    scale: Tensor

    def __init__(
        self,
        *,
        flows: Sequence[Mapping[str, Any]],
        sensors: Mapping[str, Any],
        features: Sequence[str] | None = None,
        num_samples: int | None = None,
        hidden: Sequence[int] = (64, 64),
        generator: torch.Generator | None = None,
    ) -> None:
        super().__init__()
        missing = [key for key in _SENSOR_KEYS if key not in sensors]
        if missing:
            raise ValueError(f"sensors = {dict(sensors)}: lacks {missing}")
        names = [flow.get("name") for flow in flows]
        if len(names) < 2 or None in names or len(set(names)) < len(names):
            raise ValueError(f"flows are called {names}: give two or more flows of different names")
        known = list(sensors["features"])
        if features is None:
            features = [name for name in known if name not in BOOKKEEPING]
        if not features or not set(features) <= set(known):
            raise ValueError(f"features = {list(features)}: give one or more of {known}")
        self.flows = [dict(flow) for flow in flows]
        self.sensors = {**sensors, "features": known}
        self.features = list(features)
        self.num_samples = int(sensors["num_samples"] if num_samples is None else num_samples)
        self.hidden = list(hidden)
        if self.num_samples < 1:
            raise ValueError(f"num_samples = {num_samples}: must be at least 1")
        self._columns = [known.index(name) for name in self.features]
        shape = (int(sensors["num_neuromasts"]), len(self.features))
        self.register_buffer("mean", torch.zeros(shape))
        self.register_buffer("scale", torch.ones(shape))
        self.network = make_mlp(
            num_inputs=self.num_samples * self.mean.numel(),
            num_outputs=len(self.flows),
            hidden=hidden,
            generator=generator,
        )

    @property
    def num_flows(self) -> int:
        """Number of flows n."""
        return len(self.flows)

    @property
    def num_intervals(self) -> int:
        """Number of control intervals whose samples are read."""
        return -(-self.num_samples // int(self.sensors["num_samples"]))

    def read(self, lateral_line: Tensor) -> Tensor:
        """Pick what the machine reads: ``[..., W, P, F]`` to ``[..., num_samples, P, F']``.

        Raises:
            ValueError: if there are too few samples, or other neuromasts or features.
        """
        expected = (int(self.sensors["num_neuromasts"]), len(self.sensors["features"]))
        got = tuple(lateral_line.shape[-3:])
        if len(got) < 3 or got[0] < self.num_samples or got[1:] != expected:
            raise ValueError(
                f"lateral_line has shape {tuple(lateral_line.shape)}; this machine reads [..., at "
                f"least {self.num_samples} samples, {expected[0]} neuromasts, {expected[1]} "
                "features]: stack more control intervals, or train a machine for these sensors"
            )
        return lateral_line[..., -self.num_samples :, :, :][..., self._columns]

    @torch.no_grad()
    def set_normalisation(self, lateral_line: Tensor) -> None:
        """Take mean and standard deviation of each neuromast's features from signals ``[N, ...]``.

        A feature that never changes is left with scale 1.
        """
        signal = self.read(lateral_line).flatten(0, -3).double()
        mean, scale = signal.mean(0), signal.std(0, unbiased=False)
        is_constant = scale <= 1e-6 * (1.0 + mean.abs())  # what is felt is of order one
        self.mean.copy_(mean)
        self.scale.copy_(torch.where(is_constant, 1.0, scale))

    def forward(self, lateral_line: Tensor) -> Tensor:
        """Return logits ``[..., n]``; see ``read`` for what is expected."""
        signal = (self.read(lateral_line) - self.mean) / self.scale
        logits: Tensor = self.network(signal.flatten(-3))
        return logits

    def check(self, *, flows: Sequence[Mapping[str, Any]], sensors: Mapping[str, Any]) -> None:
        """Refuse flows and sensors other than those the machine was trained for.

        Raises:
            ValueError: naming what differs.
        """
        remedy = "train one for them with experiments.train_lateral_line, or change the task back"
        if len(flows) != self.num_flows:
            raise ValueError(
                f"the lateral-line machine knows {self.num_flows} flows "
                f"({_list_names(self.flows)}), here are {len(flows)} ({_list_names(flows)}): "
                + remedy
            )
        pairs = [(f"flow {i}", *pair) for i, pair in enumerate(zip(self.flows, flows, strict=True))]
        for what, known, given in [*pairs, ("lateral line", self.sensors, sensors)]:
            for key in sorted({*known, *given}):
                if not _is_same(known.get(key), given.get(key)):
                    raise ValueError(
                        f"{what}: the lateral-line machine was trained for {key} = "
                        f"{known.get(key)!r}, here it is {given.get(key)!r}: {remedy}"
                    )

    def save(self, path: str | Path) -> None:
        """Write weights, normalisation, flows and sensors to one file."""
        settings = {
            "flows": self.flows,
            "sensors": self.sensors,
            "features": self.features,
            "num_samples": self.num_samples,
            "hidden": self.hidden,
        }
        state = {name: value.cpu() for name, value in self.state_dict().items()}
        torch.save({"format": _FORMAT, "settings": settings, "state": state}, path)

    @classmethod
    def load(cls, path: str | Path) -> LateralLineClassifier:
        """Read a machine back; it is ready to use (``eval``), on the CPU.

        The file cannot run code (``weights_only=True``).

        Raises:
            ValueError: if there is no such file, or no machine in it.
        """
        file = Path(path).expanduser()
        if not file.is_file():
            raise ValueError(
                f"lateral-line machine {file}: there is no such file; train one with "
                "python -m experiments.train_lateral_line"
            )
        try:
            content = torch.load(file, map_location="cpu", weights_only=True)
        except (OSError, RuntimeError, EOFError, pickle.UnpicklingError) as error:
            raise ValueError(
                f"lateral-line machine {file}: cannot be read ({type(error).__name__}); train it "
                "again, or give another file"
            ) from error
        if not isinstance(content, dict) or content.get("format") != _FORMAT:
            raise ValueError(
                f"lateral-line machine {file}: not one; give the file that "
                "experiments.train_lateral_line wrote"
            )
        machine = cls(**content["settings"])
        machine.load_state_dict(content["state"])
        return machine.eval()


def _list_names(flows: Sequence[Mapping[str, Any]]) -> str:
    return ", ".join(str(flow.get("name")) for flow in flows)


def _is_same(known: Any, given: Any) -> bool:
    if isinstance(known, list | tuple) and isinstance(given, list | tuple):
        return len(known) == len(given) and all(map(_is_same, known, given))
    if isinstance(known, float | int) and isinstance(given, float | int):
        return isclose(known, given, rel_tol=1e-6)
    return bool(known == given)
