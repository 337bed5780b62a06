"""Signals of flows that anyone can tell apart: sines of a frequency for each."""

import torch
from tensordict import TensorDict
from torch import Tensor

FLOWS = [
    {"name": name, "stream_speed_bl": speed, "cylinder_diameter_bl": 0.4}
    for name, speed in (("I", 1.0), ("II", 1.25), ("III", 1.5))
]
SENSORS = {
    "num_neuromasts": 5,
    "features": ["t", "x", "y", "u", "v", "p"],
    "num_samples": 16,
    "interval_T": 1.0,
}


def make_signal(flow: Tensor, time: Tensor, phase: Tensor) -> Tensor:
    """Return ``[B, 16, 5, 6]``: u and v beat at 1, 2 or 3 per interval, by flow; t is the time.

    Args:
        flow: ``[B]`` int64.
        time: ``[B]`` when the interval ends.
        phase: ``[B]`` of the beat, radians.
    """
    t = time[:, None, None] + torch.linspace(-15 / 16, 0.0, 16)[None, :, None]  # [B, W, 1]
    angle = 2 * torch.pi * (flow[:, None, None] + 1) * t + phase[:, None, None]
    angle = angle - 0.5 * torch.arange(5)  # it reaches one neuromast after another
    here = torch.ones_like(angle)
    columns = (t * here, 0.1 * phase[:, None, None] * here, 0 * here)
    return torch.stack((*columns, 1.0 + 0.2 * angle.cos(), 0.2 * angle.sin(), 0 * here), -1)


def make_samples(num_episodes: int, *, length: int = 10, seed: int = 0) -> TensorDict:
    """Return ``length`` samples of each episode, with flow and episode."""
    generator = torch.Generator().manual_seed(seed)
    episode = torch.arange(num_episodes).repeat_interleave(length)
    phase = 2 * torch.pi * torch.rand(num_episodes, generator=generator)[episode]
    flow = episode % 3
    time = torch.arange(length).repeat(num_episodes) + torch.rand(len(flow), generator=generator)
    return TensorDict(
        {"lateral_line": make_signal(flow, time, phase), "flow_index": flow, "episode": episode},
        [len(flow)],
    )
