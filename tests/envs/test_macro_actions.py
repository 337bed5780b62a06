"""Gears, rows of frequencies and legal actions."""

import pytest
import torch

from fishrl.envs.macro_actions import (
    ContinuousFrequency,
    DirectFrequencies,
    FrequencyBank,
    MacroActions,
)

ROWS = ((0.5, 1.0, 1.5, 2.0), (0.75, 1.25, 1.75, 2.25), (1.0, 1.5, 2.0, 3.0))
MACRO = MacroActions(bank=FrequencyBank(rows=ROWS))
DIRECT = DirectFrequencies(frequencies=(0.0, 1.0, 2.5))
DECELERATE, CRUISE, ACCELERATE = torch.arange(3)


def test_actions_shift_the_gear_in_the_row_of_the_flow() -> None:
    gear, flow = torch.tensor([1, 1, 1]), torch.tensor([0, 1, 2])
    for action, expected in ((DECELERATE, 0), (CRUISE, 1), (ACCELERATE, 2)):
        after = MACRO.shift(gear, action.expand(3))
        assert MACRO.select(after, flow).tolist() == [row[expected] for row in ROWS]


def test_shifts_beyond_the_ends_of_a_row_are_illegal() -> None:
    first, middle, last = [False, True, True], [True, True, True], [True, True, False]
    assert MACRO.mask(torch.arange(4)).tolist() == [first, middle, middle, last]


def test_frequency_is_interpolated_between_rows() -> None:
    gear, flow = torch.tensor([0, 2, 3]), torch.tensor([0.0, 0.5, 1.75])
    assert MACRO.select(gear, flow).tolist() == [0.5, 1.625, 2.8125]


def test_first_gear_is_the_middle_by_default() -> None:
    assert MACRO.start_gear == 1 and DIRECT.start_gear == 1
    assert MacroActions(bank=MACRO.bank, first_gear=3).start_gear == 3
    assert DirectFrequencies(frequencies=(1, 2), first_gear=1).start_gear == 1


def test_direct_frequencies_are_all_legal_in_every_flow() -> None:
    gear = DIRECT.shift(torch.tensor([0, 0, 2]), torch.tensor([2, 0, 1]))
    assert DIRECT.select(gear, torch.tensor([0, 1, 2])).tolist() == [2.5, 0.0, 1.0]
    assert DIRECT.mask(gear).all() and DIRECT.mask(gear).shape == (3, 3)
    assert DIRECT.num_flows is None and DIRECT.num_actions == 3


def test_continuous_action_is_the_frequency() -> None:
    control, gear = ContinuousFrequency(frequency_range=(0.5, 2.0)), torch.tensor([0, 0])
    action, flow = torch.tensor([[0.7], [2.0]], dtype=torch.float64), torch.tensor([0, 1])
    after, frequency = control.choose(gear, action, flow)
    assert (after == gear).all() and torch.equal(frequency, action[:, 0])
    assert control.action_bounds == ((0.5, 2.0),) and control.num_actions == 1
    for wrong in ((1.0, 1.5, 2.0), (2.0, 1.0)):
        with pytest.raises(ValueError, match="frequenc"):
            ContinuousFrequency(frequency_range=wrong)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (((1.0, 2.0), (1.0, 2.0, 3.0)), r"have \[2, 3\] frequencies: give all the same number"),
        (((2.0, 1.0),), "must be rising"),
    ],
)
def test_invalid_rows_are_refused(rows: tuple, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        FrequencyBank(rows=rows)


@pytest.mark.parametrize(("gear", "allowed"), [(-1, "at least 0"), (4, "0 to 3")])
def test_invalid_gear_is_refused(gear: int, allowed: str) -> None:
    with pytest.raises(ValueError, match=rf"first_gear = {gear}: .*{allowed}"):
        MacroActions(bank=MACRO.bank, first_gear=gear)
