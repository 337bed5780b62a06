"""Positions, colours, rates and trails in a rerun stream."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from fishrl.envs.scene import Field, Frame, Trail
from fishrl.viewer import Drawing
from fishrl.viewer.colours import PURPLE_GREEN, RED_BLUE, paint, quantise
from fishrl.viewer.drawing import TIMELINE
from fishrl.viewer.settings import FieldFormat
from tests.viewer.scenes import HEIGHT, LENGTH, make_frame, make_scene


class Notes:
    """A stream that keeps logged objects and their times by entity."""

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
    """Draw frames of flow 2 and return the log."""
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


def test_plots_hold_rates_and_legal_actions_without_nan() -> None:
    bare = make_frame(2, begins=True)
    kept = {name: bare.values[name] for name in ("vorticity", "fish", "work")}
    notes = draw(make_frame(0), make_frame(1), replace(bare, values=kept), make_frame(3))
    assert notes.numbers("flow_2/plots/power_x_T/0") == [(0.25, 2.0), (0.75, 2.0)]
    assert notes.numbers("flow_2/plots/angle/0") == [(0.0, 0.0), (0.75, 3.75)]
    assert [time for time, _ in notes.logged["flow_2/world/food"]] == [0.0, 0.25, 0.75]
    assert notes.numbers(f"{CHOICE}/legal_0") == [(0.25, 0.0), (0.75, 0.0)]
    assert notes.numbers(f"{CHOICE}/chosen") == [(0.0, 0.0), (0.25, 1.0), (0.75, 0.0)]
    one_hot = draw(carry(0.0, action=[False, False, True]))
    assert one_hot.numbers(f"{CHOICE}/chosen") == [(0.0, 2.0)]


def test_trail_is_cut_to_length_and_restarts_with_episode() -> None:
    notes = draw(*map(make_frame, range(6)), make_frame(6, begins=True), make_frame(7))
    strips = [what.strips for _, what in notes.logged["flow_2/world/trajectory_head"]]
    lengths = [len(strip.as_arrow_array().to_pylist()[0]) for strip in strips]
    assert lengths == [1, 2, 3, 4, 5, 5, 1, 2]


def test_dotted_trail_has_a_dot_at_each_place() -> None:
    scene = replace(make_scene(), trails=(Trail(key="head", is_dotted=True),))
    notes = draw(*map(make_frame, range(3)), scene=scene)
    dots = [what.positions for _, what in notes.logged["flow_2/world/trajectory_head"]]
    assert [len(each.as_arrow_array()) for each in dots] == [1, 2, 3]


def test_u8_levels_restore_signed_and_unsigned_fields() -> None:
    for key, limit, zero, num in (("vorticity", 10.0, 128.0, 127.0), ("speed", 4.0, 1.0, 254.0)):
        scene, frame = make_scene().choose_field(key, limit=limit), make_frame(0)
        notes = draw(frame, field_format="u8", scene=scene)
        assert [
            name for name in ("vorticity", "speed") if f"flow_2/world/{name}" in notes.logged
        ] == [key]
        restored = (read_levels(notes, key)[0] - zero) / num * limit
        expected = frame.values[key][0].float().clamp(-limit, limit).numpy()
        assert np.abs(restored - expected).max() <= 0.5 * limit / num + 1e-6  # half a level


@pytest.mark.parametrize("name", [RED_BLUE, PURPLE_GREEN])
def test_diverging_colours_are_white_at_zero_and_nan(name: str) -> None:
    levels = quantise(np.array([-2.0, 0.0, np.nan, 2.0], np.float32), -2.0, 2.0)
    assert levels.tolist() == [1, 128, 128, 255]
    low, middle, missing, high = paint(levels, name).astype(int)
    assert middle.min() > 240 and middle.tolist() == missing.tolist()
    assert abs(low - high).max() > 60


def test_arrow_points_up_for_positive_y() -> None:
    ((_, arrow),) = draw(make_frame(0)).logged["flow_2/world/force"]
    assert arrow.vectors.as_arrow_array().to_pylist() == [[10.0, -20.0]]
    (origin,) = arrow.origins.as_arrow_array().to_pylist()
    x, y = make_frame(0).values["centre"].tolist()
    assert origin == pytest.approx([x + 0.5, HEIGHT - 0.5 - y])  # pixel centres, with y down


def test_rewards_are_drawn_as_signed_logarithms() -> None:
    notes = draw(*(carry(i / 4, reward=reward) for i, reward in enumerate((1.0, -1.0, 31.0))))
    assert [value for _, value in notes.numbers("flow_2/plots/reward/0")] == [1.0, -1.0, 5.0]


def test_ticks_are_in_body_lengths_and_clock_in_periods() -> None:
    notes = draw(make_frame(2))
    (labels,) = notes.static["flow_2/world/axes/labels"]
    texts, places = (
        column.as_arrow_array().to_pylist() for column in (labels.labels, labels.positions)
    )
    assert places[texts.index("5 L")][0] == pytest.approx(5.0 * LENGTH + 0.5)
    ((_, clock),) = notes.logged["flow_2/world/clock"]
    assert clock.labels.as_arrow_array().to_pylist() == ["t = 0.50 T"]


def test_unknown_fields_and_invalid_limits_are_refused() -> None:
    with pytest.raises(ValueError, match="field = sped: must be one of vorticity, speed"):
        make_scene().choose_field("sped")
    for limit in (0.0, float("nan")):
        with pytest.raises(ValueError, match="must be positive"):
            Field(key="v", name="vorticity", unit="1/T", limit=limit)
