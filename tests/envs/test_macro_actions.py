"""Gears and rows of frequencies; the environment shifts them in ``test_karman_gait``."""

from collections.abc import Callable
from typing import Any

import pytest
import torch

from fishrl.envs.macro_actions import (
    BendControl,
    ContinuousFrequency,
    DirectFrequencies,
    MacroActions,
)

ROWS = ((0.5, 1.0, 1.5, 2.0), (0.75, 1.25, 1.75, 2.25), (1.0, 1.5, 2.0, 3.0))
MACRO = MacroActions(rows=ROWS)
DIRECT = DirectFrequencies(frequencies=(0.0, 1.0, 2.5))


def test_frequency_is_interpolated_between_rows() -> None:
    gear, flow = torch.tensor([1, 2, 2]), torch.tensor([0.0, 0.5, 1.75])
    after, frequency = MACRO.choose(gear, torch.tensor([0, 1, 2]), flow)
    assert after.tolist() == [0, 2, 3] and frequency.tolist() == [0.5, 1.625, 2.8125]


def test_direct_frequencies_are_all_legal_in_every_flow() -> None:
    flow = torch.tensor([0, 1, 2])
    gear, frequency = DIRECT.choose(torch.tensor([0, 0, 2]), torch.tensor([2, 0, 1]), flow)
    assert gear.tolist() == [2, 0, 1] and frequency.tolist() == [2.5, 0.0, 1.0]
    assert DIRECT.mask(gear).all() and DIRECT.mask(gear).shape == (3, 3)
    assert DIRECT.num_flows is None and DIRECT.num_actions == 3
    assert DIRECT.start_gear == MACRO.start_gear == 1  # the middle, by default
    assert DirectFrequencies(frequencies=(1, 2), first_gear=1).start_gear == 1


def test_continuous_action_is_the_frequency() -> None:
    control, gear = ContinuousFrequency(frequency_range=(0.5, 2.0)), torch.tensor([0, 0])
    action, flow = torch.tensor([[0.7], [2.0]], dtype=torch.float64), torch.tensor([0, 1])
    after, frequency = control.choose(gear, action, flow)
    assert (after == gear).all() and torch.equal(frequency, action[:, 0])
    assert control.action_bounds == ((0.5, 2.0),) and control.num_actions == 1


def test_one_row_serves_every_flow() -> None:
    control, gear = MacroActions(rows=ROWS[:1]), torch.tensor([1, 1])
    _, frequency = control.choose(gear, torch.tensor([2, 2]), torch.tensor([0.0, 2.0]))
    assert frequency.tolist() == [1.5, 1.5]


def test_discrete_bends_combine_with_every_action_of_the_beat() -> None:
    control, gear = BendControl(beat=MACRO, bend_bl=0.2), torch.tensor([0, 1, 3])
    assert control.num_actions == len(control.action_names) == 9
    assert control.action_names[5] == "cruise, right"
    flow = torch.tensor([0, 1, 2])
    assert control.mask(gear).tolist() == [
        [can] * 3 + [True] * 3 + [may] * 3 for can, may in ((0, 1), (1, 1), (1, 0))
    ]
    for action in range(9):
        beat, turn = divmod(action, 3)
        actions = torch.full((3,), action)
        inside = gear.clamp(1, 2)  # where all are legal
        for mine, its in zip(
            control.choose(inside, actions, flow),
            MACRO.choose(inside, torch.full((3,), beat), flow),
            strict=True,
        ):
            assert torch.equal(mine, its)
        bend = control.bend(actions)
        assert bend is not None and bend.tolist() == pytest.approx([0.2 * (1 - turn)] * 3)


@pytest.mark.parametrize(("own", "of_beat", "expected"), [(None, None, 2), (None, 1, 1), (3, 1, 3)])
def test_the_first_gear_of_a_fish_that_bends(own: Any, of_beat: Any, expected: int) -> None:
    assert BendControl(beat=MacroActions(first_gear=of_beat), first_gear=own).start_gear == expected


def test_continuous_bend_precedes_the_frequency() -> None:
    beat = ContinuousFrequency(frequency_range=(0.5, 2.0))
    control = BendControl(beat=beat, bend_bl=0.2)
    assert control.action_bounds == ((-0.2, 0.2), (0.5, 2.0)) and len(control.action_names) == 2
    action = torch.tensor([[0.1, 0.7]], dtype=torch.float64)
    _, frequency = control.choose(torch.tensor([0]), action, torch.tensor([0]))
    bend = control.bend(action)
    assert bend is not None and bend.tolist() == [0.1] and frequency.tolist() == [0.7]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: MacroActions(rows=((1, 2), (1, 2, 3))), r"have \[2, 3\] frequencies: give all"),
        (lambda: MacroActions(rows=((2.0, 1.0),)), "must be rising"),
        (lambda: MacroActions(rows=ROWS, first_gear=4), "first_gear = 4: .*0 to 3"),
        (lambda: BendControl(beat=BendControl()), "give a control of the tail beat alone"),
        (
            lambda: ContinuousFrequency(frequency_range=(2.0, 1.0)),
            "frequency_range = .*must be rising",
        ),
    ],
)
def test_invalid_settings_are_refused(make: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()
