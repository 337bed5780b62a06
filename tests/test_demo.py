"""The demo: recorded films at once, then a policy that swims."""

import subprocess
import sys
from pathlib import Path

import pytest

from fishrl.programs.swim import swim


@pytest.mark.smoke
def test_a_policy_swims_until_its_film_ends() -> None:
    recording, ending = swim("predation_small", periods=1.0, compile=False)
    assert ending == "still swims"
    assert 0.75 < float(recording.time[-1]) <= 1.0  # four frames per T


def test_recorded_films_come_before_anything_heavy_is_imported(tmp_path: Path) -> None:
    code = (
        "import sys, fishrl.children as c; c.start_child = lambda *_: sys.exit('swim')\n"
        "from fishrl.programs.demo import main\n"
        "assert 'torch' not in sys.modules; main(['--folder', sys.argv[1]])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True, check=False
    )
    assert done.stderr == "swim\n"
    films = sorted(path.name for path in tmp_path.iterdir())
    assert films == ["catching_food_recorded.mp4", "holding_station_recorded.mp4"]
