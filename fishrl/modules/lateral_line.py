"""The lateral-line classifier: predicts the flow label from the lateral-line signal.

The classifier of the paper is a fully connected network of one instant of
``[t, x, y, u_x, u_y, p, |u|]``, averaged over five points. Here, features and number of samples are
settings; time and position, which reveal the flow without sensing it, are excluded by default.
"""

from collections.abc import Mapping, Sequence
from math import isclose
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from fishrl.files import load_tensors, staged
from fishrl.modules.actors import make_mlp
from fishrl.settings import build

#: Features of the paper that do not measure the flow.
BOOKKEEPING = ("t", "x", "y")
_FORMAT = "fishrl lateral-line machine, 1"  # as written by version 0.1
_SENSOR_KEYS = ("num_neuromasts", "features", "num_samples")
#: Parameters of a flow or of the lateral line, by name.
Parameters = Mapping[str, str | bool | int | float | Sequence[str | int | float] | None]


class LateralLineClassifier(nn.Module):
    """Classifier of flows; maps ``lateral_line`` ``[..., W, P, F]`` to logits ``[..., n]``.

    W samples (oldest first, equidistant in time), P neuromasts, F features, n flows. The network
    reads F' features as (value - ``mean``) / ``scale``, both ``[P, F']``.

    Args:
        flows: parameters of the n flows, ordered by ``flow_index``, with a unique ``name`` each and
            numbers such as ``stream_speed_bl``.
        sensors: parameters of the lateral line: ``num_neuromasts``, names of its ``features``,
            ``num_samples`` per control interval, and others.
        features: names of the features that are read; by default all but time and position.
        num_samples: number of newest samples that are read; by default the samples of one control
            interval. More need the concatenated signals of several intervals.
        hidden: widths of the hidden layers.
        generator: draws the initial weights.

    Raises:
        ValueError: for repeated names of flows or unknown features.
    """

    mean: Tensor
    scale: Tensor

    def __init__(
        self,
        *,
        flows: Sequence[Parameters],
        sensors: Parameters,
        features: Sequence[str] | None = None,
        num_samples: int | None = None,
        hidden: Sequence[int] = (64, 64),
        generator: torch.Generator | None = None,
    ) -> None:
        super().__init__()
        if missing := [key for key in _SENSOR_KEYS if key not in sensors]:
            raise ValueError(f"sensors = {dict(sensors)}: lacks {missing}")
        names = [flow.get("name") for flow in flows]
        if len(names) < 2 or None in names or len(set(names)) < len(names):
            raise ValueError(f"flows must be two or more, with unique names; got {names}")
        self.flows: list[dict[str, Any]] = [dict(flow) for flow in flows]
        self.sensors: dict[str, Any] = dict(sensors)
        known = self.sensors["features"] = list(self.sensors["features"])
        if features is None:
            features = [name for name in known if name not in BOOKKEEPING]
        if not features or not set(features) <= set(known):
            raise ValueError(f"features = {list(features)}: give one or more of {known}")
        self.features = list(features)
        per_interval = self.sensors["num_samples"] = int(self.sensors["num_samples"])
        self.num_samples = per_interval if num_samples is None else num_samples
        self.hidden = list(hidden)
        if min(self.num_samples, per_interval) < 1:
            raise ValueError(f"num_samples = {self.num_samples}: must be at least 1")
        self._columns = [known.index(name) for name in self.features]
        shape = (int(self.sensors["num_neuromasts"]), len(self.features))
        self.register_buffer("mean", torch.zeros(shape))
        self.register_buffer("scale", torch.ones(shape))
        widths = [self.num_samples * self.mean.numel(), *hidden, len(self.flows)]
        self.network = make_mlp(widths, generator=generator)

    @property
    def num_flows(self) -> int:
        """Number of flows n."""
        return len(self.flows)

    @property
    def num_intervals(self) -> int:
        """Number of control intervals whose samples are read."""
        return -(-self.num_samples // int(self.sensors["num_samples"]))

    def read(self, lateral_line: Tensor) -> Tensor:
        """Return the input of the network, ``[..., num_samples, P, F']``."""
        expected = (int(self.sensors["num_neuromasts"]), len(self.sensors["features"]))
        got = tuple(lateral_line.shape[-3:])
        if len(got) < 3 or got[0] < self.num_samples or got[1:] != expected:
            raise ValueError(
                f"lateral_line has shape {tuple(lateral_line.shape)}; expected [..., at least "
                f"{self.num_samples} samples, {expected[0]} neuromasts, {expected[1]} features]: "
                "stack more control intervals, or train a classifier for these sensors"
            )
        return lateral_line[..., -self.num_samples :, :, :][..., self._columns]

    @torch.no_grad()
    def set_normalisation(self, lateral_line: Tensor) -> None:
        """Set mean and scale from signals ``[N, ...]``; constant features get scale 1."""
        signal = self.read(lateral_line).flatten(0, -3).double()
        mean, scale = signal.mean(0), signal.std(0, unbiased=False)
        is_constant = scale <= 1e-6 * (1.0 + mean.abs())  # signals are of order one
        self.mean.copy_(mean)
        self.scale.copy_(torch.where(is_constant, 1.0, scale))

    def forward(self, lateral_line: Tensor) -> Tensor:
        """Return logits ``[..., n]``."""
        signal = (self.read(lateral_line) - self.mean) / self.scale
        logits: Tensor = self.network(signal.flatten(-3))
        return logits

    def check(self, *, flows: Sequence[Mapping[str, Any]], sensors: Mapping[str, Any]) -> None:
        """Raise ValueError if the classifier was trained for other flows or sensors."""
        names = [{"names": [flow.get("name") for flow in each]} for each in (self.flows, flows)]
        described: list[tuple[str, Mapping[str, Any], Mapping[str, Any]]] = [
            ("flows", names[0], names[1]),
            *((f"flow {i}", *both) for i, both in enumerate(zip(self.flows, flows, strict=False))),
            ("lateral line", self.sensors, sensors),
        ]
        for what, known, given in described:
            for key in sorted({*known, *given}):
                if not _is_same(known.get(key), given.get(key)):
                    raise ValueError(
                        f"{what}: the lateral-line classifier was trained for {key} = "
                        f"{known.get(key)!r}, here it is {given.get(key)!r}: train one for this "
                        "task with fishrl train-lateral-line, or change the task back"
                    )

    def save(self, path: str | Path) -> None:
        """Write weights, normalisation, flows and sensors to a file."""
        names = ("flows", "sensors", "features", "num_samples", "hidden")
        settings = {name: getattr(self, name) for name in names}
        state = {name: value.cpu() for name, value in self.state_dict().items()}
        with staged(Path(path)) as stage:
            torch.save({"format": _FORMAT, "settings": settings, "state": state}, stage)

    @classmethod
    def load(cls, path: str | Path) -> "LateralLineClassifier":
        """Read a classifier to the CPU, in ``eval`` mode; raise ValueError for invalid files."""
        what, remedy = "lateral-line classifier", "write one with fishrl train-lateral-line"
        content = load_tensors(path, what=what, remedy=remedy)
        try:
            if content["format"] != _FORMAT:
                raise ValueError("it has another format")
            classifier = build(cls, content["settings"])
            classifier.load_state_dict(content["state"])
        except Exception as error:  # invalid types raise anything
            said = " ".join(str(error).split())
            raise ValueError(f"{what} {path}: the file does not fit ({said}); {remedy}") from error
        return classifier.eval()


def _is_same(known: Any, given: Any) -> bool:
    if isinstance(known, list | tuple) and isinstance(given, list | tuple):
        return len(known) == len(given) and all(map(_is_same, known, given))
    if isinstance(known, float | int) and isinstance(given, float | int):
        return isclose(known, given, rel_tol=1e-6)
    return bool(known == given)
