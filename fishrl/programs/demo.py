"""Watch trained policies swim: ``fishrl demo``.

Policies of ``fishrl.zoo``, trained before. Their films, recorded when they were added to the zoo,
are written at once. Then the first swims again in a flow that is computed here and now, and is
filmed by ``fishrl view``; the other would first need the wakes in which it swims.
"""

import argparse
import shutil
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

from fishrl.files import staged

ZOO = Path(__file__).parents[1] / "zoo"
#: Policies, and the names of their films.
SHOWS = {"predation_sharp": "catching_food", "gait_sharp": "holding_station"}


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line, by default that of the process."""
    parser = argparse.ArgumentParser(prog="fishrl demo", description=__doc__)
    parser.add_argument("--folder", default="demo", help="to write into (default: demo)")
    parser.add_argument("--eager", action="store_true", help="do not compile the flow step")
    options = parser.parse_args(arguments)
    folder = Path(options.folder).resolve()
    folder.mkdir(parents=True, exist_ok=True)
    for name, title in SHOWS.items():
        film = folder / f"{title}_recorded.mp4"
        with staged(film) as stage:
            shutil.copy(ZOO / name / "film.mp4", stage)
        sys.stdout.write(f"{film}: recorded film of zoo/{name}\n")
    name, title = next(iter(SHOWS.items()))
    sys.stdout.write(f"now zoo/{name} in a flow computed here, compiled first: about a minute\n")
    sys.stdout.flush()
    save = f"{folder / title}.mp4".replace("'", r"\'")
    words = [f"policy=zoo/{name}", "periods=30", f"save='{save}'"]
    view = import_module("fishrl.programs.view")  # imports torch, which takes seconds
    view.main([*words, f"flows.compile={not options.eager}"])
