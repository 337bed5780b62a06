"""The smallest Kármán gait in a wake that really sheds: eager, 80 x 48 nodes, one stream.

A half disc of 8 nodes at a Reynolds number of 180 sheds at a Strouhal number of 0.24, between
sides that are six diameters apart. It takes some seconds to develop, and a decision a fraction
of one.
"""

from functools import partial
from pathlib import Path

import pytest

from fishrl.envs import KarmanGait, wakes
from fishrl.envs.lateral_line import LateralLine
from fishrl.envs.macro_actions import DirectFrequencies
from fishrl.envs.stations import SafeArea
from fishrl.envs.streams import Stream


def make_gait(wake_folder: Path, *, has_disc: bool = True) -> KarmanGait:
    """Return the task; its wake is developed when it is needed."""
    stream = Stream(
        speeds_bl=(1.5,),
        has_disc=has_disc,
        face_bl=1.0,
        num_travels=30.0,
        num_phases=4,
        wake_folder=str(wake_folder),
    )
    return KarmanGait(
        body_length=20,
        reynolds=300.0,
        max_wall_speed=0.15,
        domain_bl=(4.0, 2.4),
        control_interval_T=0.2,  # the stream carries a fish from start to danger in 0.7 T
        start_x_bl=(0.8, 0.9),
        start_flows=(0,),
        safe_area=SafeArea(near_bl=0.2, far_bl=1.5, aside_bl=0.5),
        control=DirectFrequencies(frequencies=(0.5, 1.25, 2.0)),
        lateral_line=LateralLine(num_samples=4, noise=0.1),
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
