"""Settings of tasks, controls, streams and senses that are refused, with a remedy."""

from collections.abc import Callable
from functools import partial

import pytest

from fishrl.envs import Follower, KarmanGait, Predation, PredationPair
from fishrl.envs.changes import StreamSwitches
from fishrl.envs.control import Bend, ContinuousFrequency, MacroActions, Turn
from fishrl.envs.lateral_line import LateralLine
from fishrl.envs.streams import Stream
from tests.envs.conftest import SMALL

ROWS = ((0.5, 1.0, 1.5), (0.6, 1.1, 1.6), (0.7, 1.2, 1.7))
ONCE_PER_T = {"control_interval_T": 1.0, "checks_per_action": 25}
BENDING = Bend(beat=MacroActions(rows=ROWS), bend_bl=0.5, response_T=0.2)
food, pair = partial(Predation, **SMALL), partial(PredationPair, **SMALL)
gait = partial(KarmanGait, **SMALL | {"wall_margin_bl": 0.25, "control": MacroActions(rows=ROWS)})
ON_LEVELS = {"body_length": 16, "reynolds": 400.0, "wall_margin_bl": 0.7, "checks_per_action": 20}


def behind(**disc: object) -> KarmanGait:
    return gait(stream=Stream(**disc))


def levels(**changes: object) -> Predation:
    return Predation(levels=2, **ON_LEVELS | changes)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: food(food_limits_bl=(3.5, 1.5)), "lower limit <= food_y_bl <= upper limit"),
        (lambda: food(food_speed_bl=(0.5, 0.2)), "food_speed_bl = .*range from low to high"),
        (lambda: food(control=Turn(turn_degrees=120.0)), "turns the fish by 120° .* allowed is"),
        (lambda: food(turn_degrees=10.0), "turn_degrees: give control.turn_degrees"),
        (lambda: food(coupling="implicit"), "coupling: give skin="),
        (lambda: food(reynolds=1e6), "tau = 0.50.* outside the validated range.*raise body_length"),
        (lambda: food(critic_observes=("plaice",)), "plaice.*: allowed are place_of_the_food"),
        (lambda: pair(start_gap_bl=4.0), "start_gap_bl = 4.0: two noses do not fit into"),
        (lambda: pair(start_gap_bl=0.1), r"starts have fish 0\.\d+ L apart: must be"),
        (lambda: Follower(start_y_bl=(0.0, 0.8), aside_bl=0.7), "behind the leader"),
        (lambda: Follower(leader_x_bl=1.0), "too near the edge"),
        (lambda: gait(critic_observes=("plaice",)), "plaice.*: allowed .*; did you mean 'place'"),
        (lambda: levels(checks_per_action=200), "checks_per_action = 200: must lie in"),
        (lambda: levels(domain_bl=(4.0, 3.0)), "away from edges and sponges"),
        (lambda: behind(speeds_bl=(1.0, 1.0)), r"\['1 L/T', '1 L/T'\]: must differ"),
        (lambda: behind(diameter_bl=()), "0 for 3 entries"),
        (lambda: behind(diameter_bl=(0.4, 0.4, 0.3)), "diameter = 6.0: must be greater"),  # nodes
        (lambda: behind(diameter_bl=(0.4, 0.4, 2.15)), "DCylinder .*: they would lie 0.09 nodes"),
        (lambda: StreamSwitches(interval_T=0.5), "must end before the next"),
        (lambda: StreamSwitches(speeds_bl=(1.0, 1.0)), "must be distinct"),
        (lambda: LateralLine(first_bl=0.8), "allowed is 0 < first_bl <= last_bl < 1"),
        (lambda: LateralLine(delay=9), "delay = 9: allowed is 0 to 2 samples"),
        (lambda: MacroActions(rows=((2.0, 1.0),)), "must be rising"),
        (lambda: MacroActions(rows=ROWS, first_gear=4), "first_gear = 4: .*0 to 2"),
        (lambda: ContinuousFrequency(frequency_range=(2.0, 1.0)), "frequency_range = .*be rising"),
    ],
)
def test_settings_that_make_no_sense_are_refused(make: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()
