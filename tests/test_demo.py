"""The demo: recorded films first, then a computed one."""

import subprocess
import sys
from pathlib import Path

from fishrl.programs import view


def test_recorded_films_are_shown_before_heavy_imports(tmp_path: Path) -> None:
    key, tmp_path = tmp_path / "key", tmp_path / "o'brien, é"
    key.write_text("private")
    tmp_path.mkdir()
    (tmp_path / "catching_food_recorded.mp4").symlink_to(key)
    code = (
        "import sys, types\n"
        "from fishrl.programs.demo import main\n"
        "def show(words): assert 'torch' not in sys.modules; sys.exit('\\n'.join(words))\n"
        "sys.modules['fishrl.programs.view'] = types.SimpleNamespace(main=show)\n"
        "main(['--folder', sys.argv[1]])"
    )
    command = [sys.executable, "-c", code, str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    settings = view.main.read(done.stderr.splitlines())  # of the film to be computed
    assert settings.policy == "zoo/predation_sharp"
    assert settings.save == str(tmp_path / "catching_food.mp4")
    assert key.read_text() == "private"
    films = sorted(path.name for path in tmp_path.iterdir())
    assert films == ["catching_food_recorded.mp4", "holding_station_recorded.mp4"]
