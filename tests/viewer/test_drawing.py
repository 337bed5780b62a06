"""What is drawn into a stream: places, colours, rates, trails; and what is left out."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from fishrl.envs.scene import Field
from fishrl.viewer import Drawing, FieldFormat
from fishrl.viewer.colours import PURPLE_GREEN, RED_BLUE, paint, quantise
from fishrl.viewer.drawing import TIMELINE, place
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


@pytest.fixture
def notes() -> Notes:
    return Notes()


def draw(notes: Notes, *frames: Any, field_format: FieldFormat = FieldFormat.JPEG) -> None:
    drawing = Drawing(notes, make_scene(), flows={2: "flow 2"}, field_format=field_format)
    for frame in frames:
        drawing.draw(2, frame)


def test_node_coordinates_are_flipped_to_pixel_centres_of_the_picture() -> None:
    placed = place(torch.tensor([3.0, 10.0]), HEIGHT)
    assert placed.tolist() == [3.5, HEIGHT - 0.5 - 10.0]


def test_a_rate_is_the_change_per_T_and_an_episode_begins_without_one(notes: Notes) -> None:
    draw(notes, make_frame(0), make_frame(1), make_frame(2, begins=True), make_frame(3))
    assert notes.numbers("flow_2/plots/power_x_T/0") == [(0.25, 2.0), (0.75, 2.0)]


def test_only_legal_actions_get_a_dot(notes: Notes) -> None:
    draw(notes, make_frame(0), make_frame(1))
    path = "flow_2/plots/action_line_among_the_legal_ones_dots"
    assert notes.numbers(f"{path}/legal_0") == [(0.25, 0.0)]
    assert notes.numbers(f"{path}/legal_2") == [(0.0, 2.0), (0.25, 2.0)]
    assert notes.numbers(f"{path}/chosen") == [(0.0, 0.0), (0.25, 1.0)]


def test_of_a_one_hot_action_its_index_is_drawn(notes: Notes) -> None:
    frame = make_frame(0)
    values = {**frame.values, "action": torch.tensor([False, False, True])}
    draw(notes, replace(frame, values=values))
    path = "flow_2/plots/action_line_among_the_legal_ones_dots"
    assert notes.numbers(f"{path}/chosen") == [(0.0, 2.0)]


def test_what_is_not_a_number_or_not_there_is_left_out(notes: Notes) -> None:
    bare = make_frame(2)
    values = {name: bare.values[name] for name in ("vorticity", "fish")}
    draw(notes, make_frame(0), make_frame(1), type(bare)(time=0.5, values=values))
    assert notes.numbers("flow_2/plots/angle/0") == [(0.0, 0.0)]
    assert [time for time, _ in notes.logged["flow_2/world/food"]] == [0.0, 0.25]
    assert [time for time, _ in notes.logged["flow_2/world/fish"]] == [0.0, 0.25, 0.5]


def count_points(lines: Any) -> int:
    (strip,) = lines.strips.as_arrow_array().to_pylist()
    return len(strip)


def test_a_trail_reaches_back_so_far_and_not_into_another_episode(notes: Notes) -> None:
    frames = [make_frame(i) for i in range(8)] + [make_frame(8, begins=True), make_frame(9)]
    draw(notes, *frames)
    lengths = [count_points(what) for _, what in notes.logged["flow_2/world/trajectory_head"]]
    assert lengths == [1, 2, 3, 4, 5, 5, 5, 5, 1, 2]


def test_u8_keeps_levels_that_turn_back_into_values(notes: Notes) -> None:
    frame = make_frame(0)
    draw(notes, frame, field_format=FieldFormat.U8)
    ((_, image),) = notes.logged["flow_2/world/vorticity"]
    stored = np.array(image.buffer.as_arrow_array()[0].as_py(), np.uint8).reshape(HEIGHT, -1)
    value = (stored[0].astype(float) - 128.0) / 127.0 * 10.0
    expected = frame.values["vorticity"][0].float().clamp(-10.0, 10.0).numpy()
    assert np.abs(value - expected).max() <= 0.5 * 10.0 / 127.0 + 1e-6  # half a level


@pytest.mark.parametrize("table", [RED_BLUE, PURPLE_GREEN])
def test_colours_are_diverging_and_zero_is_their_middle(table: Any) -> None:
    levels = quantise(np.array([-2.0, 0.0, np.nan, 2.0], np.float32), -2.0, 2.0)
    assert levels.tolist() == [1, 128, 128, 255]
    assert paint(levels, table).tolist() == [list(table[i]) for i in (0, 5, 5, 10)]


def test_colours_of_a_field_without_sign_begin_at_zero(notes: Notes) -> None:
    scene = make_scene().choose_field("speed", limit=4.0)
    drawing = Drawing(notes, scene, flows={2: "flow 2"}, field_format=FieldFormat.U8)
    drawing.draw(2, make_frame(0))
    assert "flow_2/world/vorticity" not in notes.logged
    ((_, image),) = notes.logged["flow_2/world/speed"]
    stored = np.array(image.buffer.as_arrow_array()[0].as_py(), np.uint8).reshape(HEIGHT, -1)
    speed = make_frame(0).values["speed"][0].float().numpy()
    assert stored[0, 0] == 1 and speed[0] == 0.0
    assert np.abs((stored[0] - 1.0) / 254.0 * 4.0 - speed).max() <= 0.5 * 4.0 / 254.0 + 1e-6


def test_a_field_that_the_scene_does_not_have_is_refused() -> None:
    with pytest.raises(ValueError, match="field = sped: must be one of vorticity, speed"):
        make_scene().choose_field("sped")


def test_arrows_begin_at_their_point_and_point_up_in_the_picture_for_positive_y(
    notes: Notes,
) -> None:
    draw(notes, make_frame(0))
    ((_, arrow),) = notes.logged["flow_2/world/force"]
    assert arrow.vectors.as_arrow_array().to_pylist() == [[10.0, -20.0]]
    (origin,) = arrow.origins.as_arrow_array().to_pylist()
    assert origin == pytest.approx(place(make_frame(0).values["centre"], HEIGHT).tolist())


def test_small_rewards_show_beside_large_ones(notes: Notes) -> None:
    frames = [make_frame(i) for i in range(3)]
    rewards = (1.0, -1.0, 31.0)
    draw(
        notes,
        *(
            type(frame)(time=frame.time, values={"reward": torch.tensor(reward)})
            for frame, reward in zip(frames, rewards, strict=True)
        ),
    )
    assert [value for _, value in notes.numbers("flow_2/plots/reward/0")] == [1.0, -1.0, 5.0]


def test_ticks_count_body_lengths_and_the_clock_periods(notes: Notes) -> None:
    drawing = Drawing(notes, make_scene(), flows={2: "flow 2"})
    drawing.draw(2, make_frame(2))
    (labels,) = notes.static["flow_2/world/axes/labels"]
    texts, places = (
        column.as_arrow_array().to_pylist() for column in (labels.labels, labels.positions)
    )
    x, _ = places[texts.index("5 L")]
    assert x == pytest.approx(5.0 * LENGTH + 0.5)
    ((_, clock),) = notes.logged["flow_2/world/clock"]
    assert clock.labels.as_arrow_array().to_pylist() == ["t = 0.50 T"]


@pytest.mark.parametrize("limit", [0.0, -1.0, float("nan")])
def test_colours_without_a_range_are_refused(limit: float) -> None:
    with pytest.raises(ValueError, match="must be positive"):
        Field(key="v", name="vorticity", unit="1/T", limit=limit)
