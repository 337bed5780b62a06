"""Watch trained policies swim: ``fishrl demo``.

Policies of ``fishrl.zoo``, trained before. Their films, recorded when they were added to the zoo,
are written at once. Then each swims again in a flow that is computed here and now, and is filmed by
``fishrl view``.
"""

import argparse
import shutil
import subprocess
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from threading import Thread

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
    sys.stdout.write("now in flows computed here, compiled first: three minutes of CPU time\n")
    sys.stdout.flush()
    swim = "import gc; gc.disable(); import torch; torch.set_num_threads(1)"
    swim = f"{swim}; from fishrl.programs.view import main; main()"
    running = []
    for name, title, periods in SHOWS:
        words = [f"policy=zoo/{name}", f"periods={periods}", "frames_per_T=8"]
        save = f"{folder / title}.mp4".replace("'", r"\'")
        words += [f"save='{save}'", f"compile={not options.eager}"]
        child = start_child(swim, *words, stderr=subprocess.PIPE)
        shown = Thread(target=show_progress, args=(title, child.stderr or ()), daemon=True)
        shown.start()
        running.append((child, shown))
    try:
        for child, shown in running:
            shown.join()
            if status := child.wait():
                sys.exit(status)
    except KeyboardInterrupt:
        sys.exit("interrupted")


def show_progress(title: str, lines: Iterable[bytes]) -> None:
    """Write the lines of a film's process, each after the film's title."""
    for line in lines:
        sys.stderr.write(f"{title}: {line.decode(errors='replace')}")
