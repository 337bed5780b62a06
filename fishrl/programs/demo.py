"""Watch trained policies swim: ``fishrl demo``.

Policies of ``fishrl.zoo``, trained before. Their films, recorded when they were added to the zoo,
are written at once. Then each swims again in a flow that is computed here and now; an MP4, a GIF
and a picture of each are written.
"""

import argparse
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

from fishrl.children import start_child

ZOO = Path(__file__).parents[1] / "zoo"
#: Policy, name of its files, and after how many T its film ends.
SHOWS = (("predation_small", "catching_food", 30), ("gait_small", "holding_station", 12))


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line, by default that of the process."""
    parser = argparse.ArgumentParser(prog="fishrl demo", description=__doc__)
    parser.add_argument("--folder", default="demo", help="to write into (default: demo)")
    parser.add_argument("--eager", action="store_true", help="do not compile the flow step")
    options = parser.parse_args(arguments)
    folder = Path(options.folder)
    folder.mkdir(parents=True, exist_ok=True)
    for name, title, _ in SHOWS:
        film = shutil.copy(ZOO / name / "film.mp4", folder / f"{title}_recorded.mp4")
        sys.stdout.write(f"{film}: recorded film of zoo/{name}\n")
    sys.stdout.write("now in a flow computed here: about a minute, most of it compilation\n")
    sys.stdout.flush()
    swim = "import gc; gc.disable(); from fishrl.programs.swim import film; "
    running = [
        start_child(
            f"{swim}film({name!r}, {str(folder / title)!r}, periods={periods}, "
            f"compile={not options.eager})"
        )
        for name, title, periods in SHOWS
    ]
    try:
        statuses = [process.wait() for process in running]
        if any(statuses):
            sys.exit("not every film could be made")
    except KeyboardInterrupt:
        sys.exit("interrupted")
