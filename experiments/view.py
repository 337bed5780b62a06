"""Open a recorded episode in rerun: ``python -m experiments.view runs/predation/capture.rrd``."""

import argparse
import sys
from collections.abc import Sequence

from fishrl.viewer import open_recording, write_screenshot


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m experiments.view", description=__doc__)
    parser.add_argument("recording", help="a .rrd file, or a run folder that has a capture.rrd")
    parser.add_argument("--screenshot", metavar="PNG", help="write a picture instead of a window")
    parser.add_argument("--time", type=float, default=1.0, metavar="T", help="of the picture, in T")
    chosen = parser.parse_args(arguments)
    try:
        if chosen.screenshot:
            write_screenshot(chosen.recording, chosen.screenshot, time_T=chosen.time)
        else:
            open_recording(chosen.recording)
    except (FileNotFoundError, ImportError) as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
