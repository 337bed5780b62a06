"""What a live view costs is measured in pairs, in one run."""

from __future__ import annotations

import pytest

from experiments.benchmarks.live import measure
from fishrl.envs import Predation
from fishrl.envs.scene import Frame
from fishrl.viewer import Drawing
from tests.envs.conftest import SMALL, gliding  # noqa: F401 - a fixture

pytestmark = pytest.mark.usefixtures("gliding")


def test_decisions_are_timed_in_pairs_and_only_one_of_each_is_drawn(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    task, times = Predation(**SMALL), list[float]()
    draw = Drawing.draw

    def note(drawing: Drawing, flow: int, frame: Frame) -> None:
        times.append(frame.time)
        draw(drawing, flow, frame)

    monkeypatch.setattr(Drawing, "draw", note)
    seconds = measure(task, num_envs=2, pairs=2, compile=False, port=29680)
    assert {name: len(values) for name, values in seconds.items()} == {"without": 2, "live": 2}
    assert all(wall > 0.0 < busy for values in seconds.values() for wall, busy in values)
    assert {int(time - 1e-6) for time in times} == {1, 3, 5}  # every other decision


def test_no_pair_is_refused() -> None:
    with pytest.raises(ValueError, match="pairs = 0: must be at least 1"):
        measure(Predation(**SMALL), num_envs=1, pairs=0)
