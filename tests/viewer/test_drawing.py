"""Places, colours, rates and trails in a stream, and values that are left out."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from fishrl.envs.scene import Field, Frame
from fishrl.viewer import Drawing
from fishrl.viewer.colours import PURPLE_GREEN, RED_BLUE, paint, quantise
from fishrl.viewer.drawing import TIMELINE
from fishrl.viewer.settings import FieldFormat
from tests.viewer.scenes import HEIGHT, LENGTH, make_frame, make_scene


class Notes:
    """A stream that keeps what is logged, by entity, with the time it was logged at."""

    def __init__(self) -> None:
        self.time, self.logged = 0.0, dict[str, list[tuple[float, Any]]]()
        self.static = dict[str, list[Any]]()

    def set_time(self, timeline: str, *, duration: float) -> None:
        assert timeline == TIMELINE
        self.time = duration

    def log(self, path: str, what: Any, *, static: bool = False) -> None:
        if static:
            self.static.setdefault(path, []).append(what)
        else:
            self.logged.setdefault(path, []).append((self.time, what))

    def numbers(self, path: str) -> list[tuple[float, float]]:
        return [
            (time, what.scalars.as_arrow_array()[0].as_py()) for time, what in self.logged[path]
        ]


def draw(*frames: Any, field_format: FieldFormat = "jpeg", scene: Any = None) -> Notes:
    """Return what drawing frames of flow 2 logs."""
    notes = Notes()
    scene = scene or make_scene()
    drawing = Drawing(notes, scene, flows={2: "flow 2"}, field_format=field_format)
    for frame in frames:
        drawing.draw(2, frame)
    return notes


def read_levels(notes: Notes, field: str) -> np.ndarray:
    """Return the only stored picture of a field, as numbers."""
    ((_, image),) = notes.logged[f"flow_2/world/{field}"]
    return np.array(image.buffer.as_arrow_array()[0].as_py(), np.uint8).reshape(HEIGHT, -1) * 1.0


def carry(time: float, **values: Any) -> Frame:
    return Frame(time=time, values={name: torch.tensor(value) for name, value in values.items()})


CHOICE = "flow_2/plots/action_line_among_the_legal_ones_dots"


def test_rate_is_the_change_per_T_within_an_episode() -> None:
    notes = draw(make_frame(0), make_frame(1), make_frame(2, begins=True), make_frame(3))
    assert notes.numbers("flow_2/plots/power_x_T/0") == [(0.25, 2.0), (0.75, 2.0)]


def test_legal_actions_get_a_dot_and_the_chosen_one_a_line() -> None:
    notes = draw(make_frame(0), make_frame(1))
    assert notes.numbers(f"{CHOICE}/legal_0") == [(0.25, 0.0)]
    assert notes.numbers(f"{CHOICE}/legal_2") == [(0.0, 2.0), (0.25, 2.0)]
    assert notes.numbers(f"{CHOICE}/chosen") == [(0.0, 0.0), (0.25, 1.0)]
    one_hot = draw(carry(0.0, action=[False, False, True]))
    assert one_hot.numbers(f"{CHOICE}/chosen") == [(0.0, 2.0)]


def test_nan_and_missing_values_are_left_out() -> None:
    bare = make_frame(2)
    kept = {name: bare.values[name] for name in ("vorticity", "fish")}
    notes = draw(make_frame(0), make_frame(1), replace(bare, values=kept))
    assert notes.numbers("flow_2/plots/angle/0") == [(0.0, 0.0)]
    assert [time for time, _ in notes.logged["flow_2/world/food"]] == [0.0, 0.25]
    assert [time for time, _ in notes.logged["flow_2/world/fish"]] == [0.0, 0.25, 0.5]


def test_trail_has_its_length_and_restarts_with_each_episode() -> None:
    notes = draw(*map(make_frame, range(8)), make_frame(8, begins=True), make_frame(9))
    strips = [what.strips for _, what in notes.logged["flow_2/world/trajectory_head"]]
    lengths = [len(strip.as_arrow_array().to_pylist()[0]) for strip in strips]
    assert lengths == [1, 2, 3, 4, 5, 5, 5, 5, 1, 2]


def test_u8_levels_turn_back_into_values() -> None:
    frame = make_frame(0)
    stored = read_levels(draw(frame, field_format="u8"), "vorticity")
    expected = frame.values["vorticity"][0].float().clamp(-10.0, 10.0).numpy()
    error = (stored[0] - 128.0) / 127.0 * 10.0 - expected
    assert np.abs(error).max() <= 0.5 * 10.0 / 127.0 + 1e-6  # half a level


@pytest.mark.parametrize("name", [RED_BLUE, PURPLE_GREEN])
def test_zero_is_the_middle_of_diverging_colours(name: str) -> None:
    levels = quantise(np.array([-2.0, 0.0, np.nan, 2.0], np.float32), -2.0, 2.0)
    assert levels.tolist() == [1, 128, 128, 255]
    low, middle, missing, high = paint(levels, name).astype(int)
    assert middle.min() > 240 and middle.tolist() == missing.tolist()
    assert abs(low - high).max() > 60


def test_colours_of_an_unsigned_field_begin_at_zero() -> None:
    scene = make_scene().choose_field("speed", limit=4.0)
    notes = draw(make_frame(0), field_format="u8", scene=scene)
    assert "flow_2/world/vorticity" not in notes.logged
    stored, speed = read_levels(notes, "speed"), make_frame(0).values["speed"][0].float().numpy()
    assert stored[0, 0] == 1 and speed[0] == 0.0
    assert np.abs((stored[0] - 1.0) / 254.0 * 4.0 - speed).max() <= 0.5 * 4.0 / 254.0 + 1e-6


def test_arrow_begins_at_its_point_and_points_up_for_positive_y() -> None:
    ((_, arrow),) = draw(make_frame(0)).logged["flow_2/world/force"]
    assert arrow.vectors.as_arrow_array().to_pylist() == [[10.0, -20.0]]
    (origin,) = arrow.origins.as_arrow_array().to_pylist()
    x, y = make_frame(0).values["centre"].tolist()
    assert origin == pytest.approx([x + 0.5, HEIGHT - 0.5 - y])  # pixel centres, with y down


def test_rewards_are_drawn_as_logarithms_with_their_sign() -> None:
    notes = draw(*(carry(i / 4, reward=reward) for i, reward in enumerate((1.0, -1.0, 31.0))))
    assert [value for _, value in notes.numbers("flow_2/plots/reward/0")] == [1.0, -1.0, 5.0]


def test_ticks_count_body_lengths_and_the_clock_periods() -> None:
    notes = draw(make_frame(2))
    (labels,) = notes.static["flow_2/world/axes/labels"]
    texts, places = (
        column.as_arrow_array().to_pylist() for column in (labels.labels, labels.positions)
    )
    x, _ = places[texts.index("5 L")]
    assert x == pytest.approx(5.0 * LENGTH + 0.5)
    ((_, clock),) = notes.logged["flow_2/world/clock"]
    assert clock.labels.as_arrow_array().to_pylist() == ["t = 0.50 T"]


def test_unknown_fields_and_limits_that_are_not_positive_are_refused() -> None:
    with pytest.raises(ValueError, match="field = sped: must be one of vorticity, speed"):
        make_scene().choose_field("sped")
    for limit in (0.0, -1.0, float("nan")):
        with pytest.raises(ValueError, match="must be positive"):
            Field(key="v", name="vorticity", unit="1/T", limit=limit)
