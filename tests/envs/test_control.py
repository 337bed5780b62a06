"""What actions command; the environment shifts gears in ``test_karman_gait``."""

from collections.abc import Callable
from typing import Any

import pytest
import torch

from fishrl.envs.control import Bend, ContinuousFrequency, DirectFrequencies, MacroActions, Turn

ROWS = ((0.5, 1.0, 1.5, 2.0), (0.75, 1.25, 1.75, 2.25), (1.0, 1.5, 2.0, 3.0))
MACRO = MacroActions(rows=ROWS)
DIRECT = DirectFrequencies(frequencies=(0.0, 1.0, 2.5))


@pytest.mark.parametrize(
    ("control", "action", "gear", "flow", "after", "frequency"),
    [
        (MACRO, [0, 1, 2], [1, 2, 2], [0.0, 0.5, 1.75], [0, 2, 3], [0.5, 1.625, 2.8125]),
        (MacroActions(rows=ROWS[:1]), [2, 2], [1, 1], [0.0, 2.0], [2, 2], [1.5, 1.5]),
        (DIRECT, [2, 0, 1], [0, 0, 2], [0, 1, 2], [2, 0, 1], [2.5, 0.0, 1.0]),
        (ContinuousFrequency(), [[0.75], [1.5]], [0, 0], [0, 1], [0, 0], [0.75, 1.5]),
    ],
)
def test_actions_choose_gear_and_frequency(
    control: Any, action: Any, gear: Any, flow: Any, after: list[int], frequency: list[float]
) -> None:
    """Frequencies are interpolated between the rows of two flows; one row serves every flow."""
    choice = control.choose(*map(torch.tensor, (action, gear, flow)))
    assert (choice.gear.tolist(), choice.frequency.tolist()) == (after, frequency)


def test_direct_frequencies_are_all_legal_and_macro_actions_begin_in_the_middle() -> None:
    assert DIRECT.mask(torch.tensor([2, 0, 1])).tolist() == [[True] * 3] * 3
    assert DIRECT.num_flows is None and DIRECT.num_actions == 3 and MACRO.start_gear == 1


@pytest.mark.parametrize("make", [Turn, Bend])
def test_discrete_turns_run_from_right_to_left(make: Callable[..., Turn | Bend]) -> None:
    control, gear = make(beat=MACRO), torch.tensor([0, 1, 3])
    assert control.num_actions == len(control.action_names) == 9
    assert control.action_names[3:6] == ("cruise, right", "cruise, straight", "cruise, left")
    assert control.mask(gear).tolist() == [
        [can] * 3 + [True] * 3 + [may] * 3 for can, may in ((0, 1), (1, 1), (1, 0))
    ]
    inside, flow = gear.clamp(1, 2), torch.tensor([0, 1, 2])  # where all are legal
    for action in range(9):
        choice = control.choose(torch.full((3,), action), inside, flow)
        of_beat = MACRO.choose(torch.full((3,), action // 3), inside, flow)
        assert torch.equal(choice.gear, of_beat.gear)
        assert torch.equal(choice.frequency, of_beat.frequency)
        steer, largest = (
            (choice.turn, control.largest_turn)
            if make is Turn
            else (choice.bend, control.largest_bend)
        )
        assert steer is not None and steer.tolist() == [largest * (action % 3 - 1)] * 3


def test_steady_beat_leaves_only_turns() -> None:
    assert Turn().action_names == ("right", "straight", "left")
    choice = Turn().choose(torch.tensor([2]), torch.tensor([0]), torch.tensor([0]))
    assert choice.frequency.tolist() == [1.0]
    assert choice.turn is not None and choice.turn.rad2deg().tolist() == pytest.approx([15.0])


def test_continuous_bend_precedes_frequency_and_amplitude() -> None:
    beat = ContinuousFrequency(frequency_range=(0.5, 2.0), amplitude_range=(0.4, 1.0))
    control = Bend(beat=beat, bend_bl=0.2)
    assert control.action_bounds == ((-0.2, 0.2), (0.5, 2.0), (0.4, 1.0))
    assert control.num_actions == 3
    action = torch.tensor([[0.1, 0.7, 0.5]], dtype=torch.float64)
    choice = control.choose(action, torch.tensor([0]), torch.tensor([0]))
    chosen = (choice.bend, choice.frequency, choice.amplitude)
    assert [part.item() for part in chosen if part is not None] == [0.1, 0.7, 0.5]
