"""Small tasks and synthetic episodes for tests of lateral-line classifiers."""

from typing import Any

import torch
from tensordict import TensorDict

from fishrl.envs.control import MacroActions
from fishrl.envs.lateral_line import KNOWN, LateralLine
from fishrl.envs.stations import SafeArea
from fishrl.envs.streams import Stream
from fishrl.envs.tasks import KarmanGait
from fishrl.programs.lateral_line.fitting import LateralLineSettings

INTERVAL = 4


def make_task(*, speeds: tuple[float, ...] = (1.0, 1.5), **changes: Any) -> KarmanGait:
    """Return a free stream in two speeds, the smallest there is."""
    arguments: dict[str, Any] = {
        "body_length": 20,
        "reynolds": 300.0,
        "max_wall_speed": 0.15,
        "domain_bl": (5.0, 2.4),
        "stream": Stream(speeds_bl=speeds, has_disc=False, face_bl=1.0),
        "start_flows": (0, 1),
        "control": MacroActions(rows=((0.5, 1.0, 1.5), (1.0, 1.25, 1.5))),
        "start_x_bl": (1.0, 1.2),
        "safe_area": SafeArea(far_bl=2.5),
        "lateral_line": LateralLine(num_neuromasts=3, num_samples=INTERVAL),
    }
    return KarmanGait(**(arguments | changes))


def make_episodes(num: int = 40, length: int = 5) -> TensorDict:
    """Return episodes with a sine of one frequency per flow in "ahead", and noise elsewhere."""
    generator = torch.Generator().manual_seed(0)
    flow = torch.arange(num) % 2
    signal = torch.randn(num, length, INTERVAL, 3, len(KNOWN), generator=generator)
    time = torch.arange(length * INTERVAL) / INTERVAL
    phase = 6.3 * torch.rand(num, generator=generator)
    sine = (6.3 * (0.25 + 0.25 * flow[:, None]) * time + phase[:, None]).sin()
    sine = sine.view(num, length, INTERVAL, 1)
    signal[..., KNOWN.index("ahead")] = 1.0 + 0.5 * flow.view(-1, 1, 1, 1) + 0.2 * sine
    here = {"flow_index": flow, "episode": torch.arange(num)}
    is_decision = torch.arange(length) < torch.randint(2, length + 1, (num, 1), generator=generator)
    constant = TensorDict(here, [num])[:, None].expand(num, length).clone()
    return constant.update({"lateral_line": signal, "is_decision": is_decision})


def make_settings(**settings: Any) -> LateralLineSettings:
    given = {"num_epochs": 15, "learning_rate": 0.01, "hidden": (8,), **settings}
    return LateralLineSettings(**{"task": make_task(), **given})
