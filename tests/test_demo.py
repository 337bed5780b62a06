"""The demo: recorded films first, then a computed one."""

import subprocess
import sys
from pathlib import Path

from fishrl.programs import view


def run(code: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a script in another process, with the folder as its argument."""
    command = [sys.executable, "-c", code, str(folder)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_recorded_films_are_shown_before_heavy_imports(tmp_path: Path) -> None:
    key, tmp_path = tmp_path / "key", tmp_path / "o'brien, é"
    key.write_text("private")
    tmp_path.mkdir()
    (tmp_path / "catching_food_recorded.mp4").symlink_to(key)
    code = (
        "import sys, fishrl.children as children\n"
        "children.start_child = lambda _, *words, **__: sys.exit('\\n'.join(words))\n"
        "from fishrl.programs.demo import main\n"
        "assert 'torch' not in sys.modules; main(['--folder', sys.argv[1]])"
    )
    done = run(code, tmp_path)
    settings = view.main.read(done.stderr.splitlines())  # of the film to be computed
    assert settings.policy == "zoo/predation_sharp"
    assert settings.save == str(tmp_path / "catching_food.mp4")
    assert key.read_text() == "private"
    films = sorted(path.name for path in tmp_path.iterdir())
    assert films == ["catching_food_recorded.mp4", "holding_station_recorded.mp4"]


def test_progress_and_errors_of_film_are_shown(tmp_path: Path) -> None:
    code = (
        "import sys, fishrl.children as children\n"
        "swim = 'import sys; sys.exit(\"recording ...\\\\nno\")'\n"
        "start = children.start_child\n"
        "children.start_child = lambda _, *words, **options: start(swim, **options)\n"
        "from fishrl.programs.demo import main; main(['--folder', sys.argv[1]])"
    )
    done = run(code, tmp_path)
    assert done.stderr.splitlines() == ["recording ...", "no"] and done.returncode == 1
