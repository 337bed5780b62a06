"""Watch trained policies swim: ``fishrl demo``.

Policies of ``fishrl.zoo``, trained before. Their films, recorded when they were added to the zoo,
are written at once. Then each swims again in a flow that is computed here and now, and is filmed by
``fishrl view``.
"""

import argparse
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from fishrl.children import start_child
from fishrl.files import staged

ZOO = Path(__file__).parents[1] / "zoo"
#: Policy, name of its files, and after how many T its film ends.
SHOWS = (("predation_small", "catching_food", 30), ("gait_sharp", "holding_station", 12))


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line, by default that of the process."""
    parser = argparse.ArgumentParser(prog="fishrl demo", description=__doc__)
    parser.add_argument("--folder", default="demo", help="to write into (default: demo)")
    parser.add_argument("--eager", action="store_true", help="do not compile the flow step")
    options = parser.parse_args(arguments)
    folder = Path(options.folder).resolve()
    folder.mkdir(parents=True, exist_ok=True)
    for name, title, _ in SHOWS:
        film = folder / f"{title}_recorded.mp4"
        with staged(film) as stage:
            shutil.copy(ZOO / name / "film.mp4", stage)
        sys.stdout.write(f"{film}: recorded film of zoo/{name}\n")
    sys.stdout.write("now in a flow computed here: about a minute, most of it compilation\n")
    sys.stdout.flush()
    swim = "import gc; gc.disable(); import torch; torch.set_num_threads(1)"
    swim = f"{swim}; from fishrl.programs.view import main; main()"
    with TemporaryDirectory() as place:  # where developed wakes are stored
        running = {}
        for name, title, periods in SHOWS:
            words = [f"policy=zoo/{name}", f"periods={periods}", "frames_per_T=8"]
            save = f"{folder / title}.mp4".replace("'", r"\'")
            words += [f"save='{save}'", f"compile={not options.eager}"]
            log = Path(place, name)
            running[log] = start_child(swim, *words, cwd=place, stderr=log.open("a"))
        try:
            for log, process in running.items():
                if process.wait():
                    sys.exit(log.read_text(encoding="utf-8").strip())
        except KeyboardInterrupt:
            sys.exit("interrupted")
