"""The smallest Kármán gait in a wake that really sheds: eager, 80 x 48 nodes, one stream.

A half disc of 8 nodes at a Reynolds number of 180 sheds at a Strouhal number of 0.24, between
sides that are six diameters apart. It takes some seconds to develop, and a decision a fraction
of one.
"""

from functools import partial
from pathlib import Path

import pytest

from fishrl.envs import KarmanGait, wakes
from fishrl.envs.macro_actions import DirectFrequencies
from fishrl.envs.streams import Stream
from tests.envs.test_real_wake import STREAM, TINY


def make_gait(wake_folder: Path, *, has_disc: bool = True) -> KarmanGait:
    """Return the task; its wake is developed when it is needed."""
    stream = Stream(**STREAM, speeds_bl=(1.5,), has_disc=has_disc, wake_folder=str(wake_folder))
    return KarmanGait(
        **TINY,
        control_interval_T=0.2,  # the stream carries a fish from start to danger in 0.7 T
        start_flows=(0,),
        control=DirectFrequencies(frequencies=(0.5, 1.25, 2.0)),
        stream=stream,
    )


def develop(wake_folder: Path) -> KarmanGait:
    """Return the task, with its wake in a file of the folder."""
    task = make_gait(wake_folder)
    with pytest.MonkeyPatch.context() as patch:
        eager = partial(wakes.develop_wakes, compile=False)
        patch.setattr(wakes, "develop_wakes", lambda recipe, **_: eager(recipe))
        assert task.wakes is not None
    return task
