"""The smallest Kármán gait in a wake that really sheds: eager, 80 x 48 nodes, one stream.

A half disc of 8 nodes at a Reynolds number of 180 sheds at a Strouhal number of 0.24, between
sides that are six diameters apart. It takes some seconds to develop, and a decision a fraction
of one.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from fishrl.envs import KarmanGait
from fishrl.envs import wakes as wakes_module
from fishrl.settings import build

ENVS = "fishrl.envs"


def gait_settings(wake_folder: Path) -> dict[str, Any]:
    """Return ``_target_`` and arguments of the task."""
    return {
        "_target_": f"{ENVS}.KarmanGait",
        "body_length": 20,
        "reynolds": 300.0,
        "max_wall_speed": 0.15,
        "domain_bl": [4.0, 2.4],
        "control_interval_T": 0.2,  # the stream carries a fish from start to danger in 0.7 T
        "start_x_bl": [0.8, 0.9],
        "start_flows": [0],
        "safe_area": {
            "_target_": f"{ENVS}.stations.SafeArea",
            "near_bl": 0.2,
            "far_bl": 1.5,
            "aside_bl": 0.5,
        },
        "control": {
            "_target_": f"{ENVS}.macro_actions.DirectFrequencies",
            "frequencies": [0.5, 1.25, 2.0],
        },
        "lateral_line": {
            "_target_": f"{ENVS}.lateral_line.LateralLine",
            "num_samples": 4,
            "noise": 0.1,
        },
        "stream": {
            "_target_": f"{ENVS}.streams.Stream",
            "speeds_bl": [1.5],
            "face_bl": 1.0,
            "num_travels": 30.0,
            "num_phases": 4,
            "wake_folder": str(wake_folder),
        },
    }


def develop(wake_folder: Path) -> KarmanGait:
    """Return the task, with its wake in a file of the folder."""
    task: KarmanGait = build(KarmanGait, gait_settings(wake_folder))
    develop_wakes = wakes_module.develop_wakes
    with pytest.MonkeyPatch.context() as patch:
        eager = {"compile": False}
        patch.setattr(
            wakes_module, "develop_wakes", lambda recipe, **_: develop_wakes(recipe, **eager)
        )
        assert task.wakes is not None
    return task
