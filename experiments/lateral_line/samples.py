"""From episodes to samples: windows of any length of what a lateral line sensed."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from fishrl.envs.lateral_line import KNOWN

#: Features that change their sign in a mirror along the stream.
_ODD = ("u_y", "left", "shear")


def select_features(
    episodes: TensorDict, *, features: Sequence[str], is_averaged: bool
) -> TensorDict:
    """Return episodes as ``collect`` does, with some features (of ``KNOWN``) of the signal only.

    If ``is_averaged``, only the mean over the neuromasts is kept.
    """
    signal = episodes["lateral_line"][..., [KNOWN.index(name) for name in features]]
    if is_averaged:
        signal = signal.mean(-2, keepdim=True)
    return episodes.copy().set("lateral_line", signal)


def mirror(signal: Tensor, *, features: Sequence[str], middle_bl: float) -> Tensor:
    """Return the signal of the mirror image of a fish in the mirror image of its flow.

    Flow, disc and fish are symmetric, so the image is as valid a sample as the original; a learned
    heading controller, which need not be symmetric, is mirrored with them.

    Args:
        signal: ``[N, W, P, F]``: neuromasts as ``LateralLine`` orders them, or their mean.
        features: names of the F.
        middle_bl: y of the plane of symmetry in body lengths.
    """
    num = signal.shape[2]
    order = list(range(num))
    for right in range(num % 2, num, 2):
        order[right], order[right + 1] = right + 1, right
    image = signal[:, :, order].clone()
    for number, name in enumerate(features):
        if name in _ODD:
            image[..., number].neg_()
        elif name == "y":
            image[..., number] = 2.0 * middle_bl - image[..., number]
    return image


def cut_windows(episodes: TensorDictBase, *, num_samples: int) -> TensorDict:
    """Cut the signal of each episode into windows, one that ends at each of its samples.

    Before the start the first sample is repeated, as the environment does.

    Args:
        episodes: ``[E, D]`` as ``collect`` returns.
        num_samples: length of the windows.

    Returns:
        TensorDict ``[N]`` with ``lateral_line`` ``[N, num_samples, P, F]``; ``decision``, the
        number (from 0) of the decision that the last sample precedes; ``is_whole``, whether the
        window ends right at the decision; and the other entries of ``episodes``.

    Raises:
        ValueError: for windows without samples.
    """
    if num_samples < 1:
        raise ValueError(f"num_samples = {num_samples}: a window has at least 1")
    signal = episodes["lateral_line"]
    rows, num_decisions, interval = signal.shape[:3]
    series = signal.flatten(1, 2)  # [E, D * W, P, F]
    first = series[:, :1].expand(-1, num_samples - 1, -1, -1)
    windows = torch.cat((first, series), 1).unfold(1, num_samples, 1).movedim(-1, 2)
    is_whole = (torch.arange(num_decisions * interval) + 1) % interval == 0
    decision = torch.arange(num_decisions).repeat_interleave(interval)
    is_used = episodes["is_decision"].repeat_interleave(interval, 1)
    is_used &= is_whole | (decision > 0)  # at reset all samples of the interval are the first one
    kept = {
        "decision": decision.expand(rows, -1),
        "is_whole": is_whole.expand(rows, -1),
        **{
            str(name): value.repeat_interleave(interval, 1)
            for name, value in episodes.items()
            if name not in ("lateral_line", "is_decision")
        },
    }
    cut = {name: value[is_used] for name, value in kept.items()}
    return TensorDict({"lateral_line": windows[is_used], **cut}, [int(is_used.sum())])
