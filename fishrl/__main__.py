"""Run a program: ``fishrl train task=predation``, or ``python -m fishrl train task=predation``."""

from __future__ import annotations

import gc
import signal
import sys
from importlib import import_module
from pathlib import Path

PROGRAMS = (
    *("train", "evaluate", "view", "summarize", "search", "transfer", "demo"),
    *("export", "export-data", "export-policy", "train-lateral-line"),
)


def main() -> None:
    """Run the program that the first word of the command line names."""
    if len(sys.argv) < 2 or sys.argv[1] not in PROGRAMS:
        sys.exit(f"usage: fishrl <program> [settings]\nprograms: {', '.join(PROGRAMS)}")
    # Until the program begins: searching what imports make for garbage would take seconds, and
    # Ctrl-C ends the program without a traceback.
    gc.disable()
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    name = sys.argv.pop(1)
    module = Path(__file__).parent / "programs" / f"{name.replace('-', '_')}.py"
    import_module(f"fishrl.programs.{module.stem}").main()


if __name__ == "__main__":
    main()
