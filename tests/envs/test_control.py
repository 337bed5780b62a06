"""What actions command; the environment shifts gears in ``test_karman_gait``."""

from collections.abc import Callable

import pytest
import torch

from fishrl.envs.control import Bend, ContinuousFrequency, DirectFrequencies, MacroActions, Turn

ROWS = ((0.5, 1.0, 1.5, 2.0), (0.75, 1.25, 1.75, 2.25), (1.0, 1.5, 2.0, 3.0))
MACRO = MacroActions(rows=ROWS)
DIRECT = DirectFrequencies(frequencies=(0.0, 1.0, 2.5))


def test_frequency_is_interpolated_between_rows() -> None:
    gear, flow = torch.tensor([1, 2, 2]), torch.tensor([0.0, 0.5, 1.75])
    after, frequency, *_ = MACRO.choose(torch.tensor([0, 1, 2]), gear, flow)
    assert after.tolist() == [0, 2, 3] and frequency.tolist() == [0.5, 1.625, 2.8125]


def test_direct_frequencies_are_all_legal_in_every_flow() -> None:
    flow = torch.tensor([0, 1, 2])
    gear, frequency, *_ = DIRECT.choose(torch.tensor([2, 0, 1]), torch.tensor([0, 0, 2]), flow)
    assert gear.tolist() == [2, 0, 1] and frequency.tolist() == [2.5, 0.0, 1.0]
    assert DIRECT.mask(gear).all() and DIRECT.mask(gear).shape == (3, 3)
    assert DIRECT.num_flows is None and DIRECT.num_actions == 3
    assert MACRO.start_gear == 1  # the middle, by default


def test_continuous_action_is_the_frequency() -> None:
    control, gear = ContinuousFrequency(frequency_range=(0.5, 2.0)), torch.tensor([0, 0])
    action, flow = torch.tensor([[0.7], [2.0]], dtype=torch.float64), torch.tensor([0, 1])
    after, frequency, *_ = control.choose(action, gear, flow)
    assert (after == gear).all() and torch.equal(frequency, action[:, 0])
    assert control.action_bounds == ((0.5, 2.0),) and control.num_actions == 1


def test_one_row_serves_every_flow() -> None:
    control, gear = MacroActions(rows=ROWS[:1]), torch.tensor([1, 1])
    choice = control.choose(torch.tensor([2, 2]), gear, torch.tensor([0.0, 2.0]))
    assert choice.frequency.tolist() == [1.5, 1.5]


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
