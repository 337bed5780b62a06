"""Presets of earlier versions: what replaces each has the same settings, and errors name it."""

from collections.abc import Iterator, Mapping
from typing import Any

import pytest

from fishrl.envs import make_task
from fishrl.presets import REPLACED, list_names
from fishrl.programs.train_settings import TRAINING
from fishrl.settings import to_plain

GAIT = "gait_small"
FLOWS = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11]
#: What each preset built on, and what it set on top, as its file last said (commit 336d8089).
FORMER: dict[str, tuple[list[str], dict[str, Any]]] = {
    "small": ([], {"task.body_length": 50, "task.levels": 1}),
    "follower_small": (
        ["task=follower", "algorithm=sac"],
        {
            "task.domain_bl": [5.5, 2.5],
            "task.range_bl": [0.5, 2.5],
            "task.time_limit": 80,
            "batch_size": 128,
            "buffer_size": 50000,
            "total_frames": 6000,
            "warmup_frames": 640,
            "updates_per_frame": 2.0,
            "checkpoint_frames": 1000,
            "eval_frames": 6000,
            "eval_episodes": 4,
            "final_episodes": 16,
        },
    ),
    "gait_half": ([f"preset={GAIT}"], {"task.body_length": 64}),
    "gait_narrow": (
        [f"preset={GAIT}"],
        {
            "task.body_length": 64,
            "task.max_wall_speed": 0.1101,
            "task.control.rows": [
                [0.432, 0.486, 0.54, 0.594, 0.648],
                [0.533, 0.599, 0.666, 0.733, 0.799],
                [0.62, 0.7, 0.776, 0.855, 0.93],
            ],
        },
    ),
    "gait_paper": (
        [f"preset={GAIT}"],
        {
            "task.body_length": 100,
            "task.skin._target_": "fishrl.physics.skins.immersed_boundary.ImmersedBoundary",
        },
    ),
    "gait_varied": (
        [f"preset={GAIT}", "task=karman_varied"],
        {
            "task.start_flows": FLOWS,
            "task.start_x_bl": [1.0, 3.5],
            "task.start_y_bl": [-0.6, 0.6],
        },
    ),
}


def flatten(node: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield all values of nested settings with their dotted keys."""
    for name, value in node.items():
        if isinstance(value, Mapping):
            yield from flatten(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def compose(words: list[str]) -> dict[str, Any]:
    """Return the settings of a training; of its skin only the kind."""
    settings = dict(flatten(to_plain(TRAINING.read(words))))
    kind = "task.skin._target_"
    return {k: v for k, v in settings.items() if not k.startswith("task.skin.") or k == kind}


@pytest.mark.parametrize("name", REPLACED)
def test_command_line_in_place_of_preset_has_its_settings(name: str) -> None:
    base, changes = FORMER[name]
    expected = compose(base)
    assert changes.keys() <= expected.keys()
    assert compose(REPLACED[name].split()) == expected | changes


@pytest.mark.parametrize("name", REPLACED)
def test_former_name_is_refused_with_what_replaces_it(name: str) -> None:
    assert name not in list_names("preset")
    for read in (lambda: TRAINING.read([f"preset={name}"]), lambda: make_task(name)):
        with pytest.raises(ValueError, match="any more; give ") as error:
            read()
        assert str(error.value).split("; give ")[1].startswith(REPLACED[name])
